"""Opening files: what may be read, and which format it is."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document

_READABLE = "beltrami reads PLY, OBJ, glTF (.gltf) and GLB files"


def open_document(source: str) -> Document:
    """Read a file, or standard input, as the document that it is.

    Parameters
    ----------
    source : str
        Path, or "-" for standard input (PLY or GLB).

    Returns
    -------
    Document
        Of the format that the content shows; only OBJ, which has no mark of its own, is told by its name.

    Raises
    ------
    InputError
        If the file cannot be read or is of none of the formats.
    """
    if source == "-":
        return recognise(sys.stdin.buffer.read(), "<stdin>", None)
    path = Path(source)
    return recognise(_read(path, source), source, path.parent)


def recognise(data: bytes, name: str, folder: Path | None) -> Document:
    """Choose the format by content.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        The file as the user named it.
    folder : Path or None
        Where other files that belong to the model may lie; None: nowhere.

    Returns
    -------
    Document

    Raises
    ------
    InputError
        If no format fits, or the one that does finds the file damaged.
    """
    # Each format's reader is imported only when it is needed, to start fast.
    if data[:4] in (b"ply\n", b"ply\r"):
        from beltrami_cli.formats.ply import PlyDocument

        return PlyDocument(data, name, folder)
    if data[:4] == b"glTF" or data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{":
        from beltrami_cli.formats.gltf import GltfDocument

        return GltfDocument(data, name, folder)
    if name.lower().endswith(".obj"):
        from beltrami_cli.formats.obj import ObjDocument

        return ObjDocument(data, name, folder)
    if not data:
        raise InputError(name, "the file is empty", _READABLE)
    raise InputError(name, "the content is of no known format", _READABLE)


def _read(path: Path, name: str) -> bytes:
    try:
        # Without O_NONBLOCK, opening a FIFO that nobody writes to would wait for ever.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError(
                    name, "it is not a regular file", "give a file, or pipe the model in and name it -"
                )
            return file.read()
    except OSError as error:
        raise InputError(
            name, f"cannot be read ({error.strerror})", "check the path and its permissions"
        ) from error
