"""Files that a glTF names beside itself: which URIs are followed, and which never are."""

from __future__ import annotations

import base64
import binascii
import re
from pathlib import PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote, unquote_to_bytes

if TYPE_CHECKING:
    from pathlib import Path

    from beltrami_cli.formats.document import Bytes

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")


class UnfitReferenceError(Exception):
    """A URI that is not followed; the message is the reason, to be put after the place where it stands."""


def is_data(uri: str) -> bool:
    """Return whether a URI carries its bytes itself."""
    return uri[:5].lower() == "data:"


def embedded(uri: str) -> bytes:
    """Return the bytes of a data URI.

    Raises
    ------
    UnfitReferenceError
        If it has no comma, or its base64 is damaged.
    """
    head, comma, payload = uri.partition(",")
    if not comma:
        raise UnfitReferenceError("is a data URI without a comma")
    octets = unquote_to_bytes(payload)
    if not head.lower().endswith(";base64"):
        return octets
    try:
        return base64.b64decode(octets + b"=" * (-len(octets) % 4), validate=True)
    except binascii.Error as error:
        raise UnfitReferenceError(f"is a data URI with damaged base64 ({error})") from None


def re_embedded(uri: str, data: Bytes) -> str:
    """Return a data URI with the media type of another one and new bytes, always base64."""
    head = uri.partition(",")[0]
    head = head if head.lower().endswith(";base64") else head + ";base64"
    return f"{head},{base64.b64encode(data).decode('ascii')}"


def relative_name(uri: str) -> str:
    """Return the relative path that a URI names, percent-decoded, with "/" as separator.

    Raises
    ------
    UnfitReferenceError
        If it has a scheme, is absolute, or steps out of the folder.
    """
    name = unquote(uri)
    if _SCHEME.match(uri) or _SCHEME.match(name):
        raise UnfitReferenceError(
            f"{_short(uri)} is not a relative path; only files beside the model are read"
        )
    if not name or name.startswith("/") or "\\" in name or "\0" in name or ".." in name.split("/"):
        raise UnfitReferenceError(f"{_short(uri)} leaves the model's folder; only files inside it are read")
    return str(PurePosixPath(name))


def located(uri: str, folder: Path | None) -> Path:
    """Return the path of a regular file inside the folder.

    Parameters
    ----------
    uri : str
        As it stands in the JSON.
    folder : pathlib.Path or None
        Folder of the model; None when the model came through a pipe.

    Raises
    ------
    UnfitReferenceError
        If the file is missing, not a regular file, or outside the folder (also through a symbolic link).
    """
    name = relative_name(uri)
    if folder is None:
        raise UnfitReferenceError(f"{_short(uri)} is a file beside the model, whose folder is not known")
    try:
        path = (folder / name).resolve()
        if not path.is_relative_to(folder.resolve()):
            raise UnfitReferenceError(f"{_short(uri)} leads out of the model's folder")
        if not path.is_file():
            raise UnfitReferenceError(
                f"{_short(uri)} " + ("is not a regular file" if path.exists() else "is missing")
            )
    except (OSError, RuntimeError, ValueError) as error:
        raise UnfitReferenceError(f"{_short(uri)} cannot be opened ({error})") from None
    return path


def read(uri: str, folder: Path | None) -> bytes:
    """Return the bytes that a URI stands for: embedded ones, or those of a file inside the folder.

    Raises
    ------
    UnfitReferenceError
        As `embedded` and `located`, and if the file cannot be read.
    """
    if is_data(uri):
        return embedded(uri)
    try:
        return located(uri, folder).read_bytes()
    except OSError as error:
        raise UnfitReferenceError(f"{_short(uri)} cannot be read ({error.strerror})") from None


def as_uri(name: str) -> str:
    """Return the URI of a relative path."""
    return quote(name)


def _short(uri: str) -> str:
    return repr(uri if len(uri) <= 80 else uri[:77] + "...")
