"""Opening files: what may be read, and which format it is."""

from __future__ import annotations

import errno
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, NotRegularError, read_regular
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.formats.npz import NpzArchive

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document

_ARCHIVES = {
    "ZIP": (b"PK\x03\x04", 0),
    "empty ZIP": (b"PK\x05\x06", 0),
    "gzip": (b"\x1f\x8b", 0),
    "bzip2": (b"BZh", 0),
    "xz": (b"\xfd7zXZ\0", 0),
    "Zstandard": (b"\x28\xb5\x2f\xfd", 0),
    "7z": (b"7z\xbc\xaf\x27\x1c", 0),
    "RAR": (b"Rar!\x1a\x07", 0),
    "tar": (b"ustar", 257),
}
"""What archives and compressed files start with, and where that stands."""

_JSON = re.compile(rb"(?:\xef\xbb\xbf)?[ \t\r\n]*\{")
_PIECE = 1 << 24
_READABLE = (
    "beltrami reads PLY, OBJ, glTF (.gltf) and GLB files, points in .xyz, .pts and .npz, and the colours of OFF, STL, "
    "3MF and DAE files"
)
_LINES_OF_POINTS = {".xyz": "xyz", ".xyzrgb": "xyz", ".pts": "pts"}


def open_document(source: str, access: Access = EVERYTHING_INSIDE) -> Document:
    """Read a file, or standard input, as the document that it is.

    Parameters
    ----------
    source : str
        Path, or "-" for standard input (what its content shows).
    access : Access
        What may be read.

    Returns
    -------
    Document
        Of the format that the content shows; only OBJ and lines of points, which have no mark of their own, are told by
        the name.

    Raises
    ------
    InputError
        If the file cannot be read or is of none of the formats.
    """
    return document_of(read_source(source, access), source, access)


def document_of(data: bytes, source: str, access: Access = EVERYTHING_INSIDE) -> Document:
    """Return the document that a source is whose bytes have been read already; see `open_document`."""
    if source == "-":
        return recognise(data, "<stdin>", None, access)
    return recognise(data, source, Path(source).parent, access)


def read_source(source: str, access: Access = EVERYTHING_INSIDE) -> bytes:
    """Read a whole file, or standard input.

    Parameters
    ----------
    source : str
        Path, or "-" for standard input.
    access : Access
        What may be read.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    return _read_stdin(access) if source == "-" else _read_file(Path(source), source, access)


def recognise(data: bytes, name: str, folder: Path | None, access: Access = EVERYTHING_INSIDE) -> Document:
    """Choose the format by content.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        The file as the user named it.
    folder : Path or None
        Where other files that belong to the model may lie; None: nowhere.
    access : Access
        What may be read.

    Returns
    -------
    Document

    Raises
    ------
    InputError
        If no format fits, or the one that does finds the file damaged.
    """
    # Each format's reader is imported only when it is needed, to start fast.
    if data[:3] == b"ply" and data[3:4] in (b"\n", b"\r", b" ", b"\t"):
        from beltrami_cli.formats.ply import PlyDocument

        return PlyDocument(data, name, folder, access)
    if data[:4] == b"glTF" or _JSON.match(data):
        from beltrami_cli.formats.gltf import GltfDocument

        return GltfDocument(data, name, folder, access)
    if NpzArchive.recognises(data):
        from beltrami_cli.formats.points import NpzPointsDocument

        return NpzPointsDocument(data, name, access)
    if not name.lower().endswith(".obj"):
        from beltrami_cli.formats.read_only import ReadOnlyDocument, kind_of

        kind = kind_of(data, name)
        if kind is not None:
            return ReadOnlyDocument(data, name, kind, access)
    archive = _archive(data)
    if archive is not None:
        raise InputError(
            name, f"it is a {archive} archive, which is not opened", "unpack it, and give the model"
        )
    if name.lower().endswith(".obj"):
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError(name, "it is text in UTF-16", "save it as UTF-8")
        from beltrami_cli.formats.obj import ObjDocument

        return ObjDocument(data, name, folder, access)
    lines = _LINES_OF_POINTS.get(Path(name).suffix.lower())
    if lines and data:
        from beltrami_cli.formats.points import TextPointsDocument

        return TextPointsDocument(data, name, lines)
    if not data:
        raise InputError(name, "the file is empty", _READABLE)
    if is_image(data, name):
        raise InputError(name, "it is an image, and no model", _READABLE)
    if not Path(name).suffix:  # standard input among them
        cause = "the content has no mark of a known format"
        raise InputError(name, cause, "give OBJ files, and points in .xyz and .pts, by their names")
    raise InputError(name, "the content is of no known format", _READABLE)


def _read_file(path: Path, name: str, access: Access) -> bytes:
    try:
        return read_regular(path, access)
    except NotRegularError as error:
        remedy = "give a file, or pipe the model in and name it -"
        raise InputError(name, "it is not a regular file", remedy) from error
    except OSError as error:
        too_large = error.errno == errno.EFBIG
        remedy = "raise --max-memory" if too_large else "check the path and its permissions"
        raise InputError(name, f"cannot be read ({error.strerror})", remedy) from error


def _read_stdin(access: Access) -> bytes:
    pieces, size = [], 0
    while piece := sys.stdin.buffer.read(_PIECE):  # room for all that is asked for at once is taken at once
        pieces.append(piece)
        size += len(piece)
        if access.memory is not None and size > access.memory:
            raise InputError("<stdin>", f"it has more than {access.memory} bytes", "raise --max-memory")
    return b"".join(pieces)


def _archive(data: bytes) -> str | None:
    """Tell the kind of an archive or compressed file by its first bytes."""
    for kind, (signature, at) in _ARCHIVES.items():
        if data[at : at + len(signature)] == signature:
            return kind
    return None
