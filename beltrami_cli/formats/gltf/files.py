"""Files that a glTF names beside itself: which URIs are followed, and which never are."""

from __future__ import annotations

import base64
import binascii
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote, unquote_to_bytes

from beltrami_cli.formats.model_folder import UnfitReferenceError, checked_path

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.model_folder import ModelFolder


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


def relative_name(uri: str, *, outside: bool = False) -> str:
    """Return the relative path that a URI names, percent-decoded, with "/" as separator.

    Parameters
    ----------
    uri : str
        As it stands in the JSON.
    outside : bool
        Whether the path may be absolute or step out of the folder.

    Raises
    ------
    UnfitReferenceError
        If it is no such path.
    """
    name = unquote(uri)
    try:
        if "\\" in name or "\0" in name:
            raise UnfitReferenceError("is not a path as glTF spells it")
        return checked_path(name, outside=outside)
    except UnfitReferenceError as error:
        raise UnfitReferenceError(f"{_short(uri)} {error}") from None


def located(uri: str, beside: ModelFolder) -> str:
    """Return the path of a regular file, relative to the model's folder.

    Parameters
    ----------
    uri : str
        As it stands in the JSON.
    beside : ModelFolder
        The folder of the model.

    Raises
    ------
    UnfitReferenceError
        If the file is missing, not a regular file, or must not be read.
    """
    name = relative_name(uri, outside=beside.access.outside)
    try:
        return beside.locate(name)
    except UnfitReferenceError as error:
        raise UnfitReferenceError(f"{_short(uri)} {error}") from None


def read(uri: str, beside: ModelFolder) -> bytes:
    """Return the bytes that a URI stands for: embedded ones, or those of a file.

    Raises
    ------
    UnfitReferenceError
        As `embedded` and `located`, and if the file cannot be read.
    """
    if is_data(uri):
        return embedded(uri)
    try:
        return beside.read(located(uri, beside))
    except OSError as error:
        raise UnfitReferenceError(f"{_short(uri)} cannot be read ({error.strerror})") from None


def as_uri(name: str) -> str:
    """Return the URI of a relative path."""
    return quote(name)


def _short(uri: str) -> str:
    return repr(uri if len(uri) <= 80 else uri[:77] + "...")
