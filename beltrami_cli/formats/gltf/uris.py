"""Files that a glTF names beside itself: which URIs are followed, which never are, and what they stand for."""

from __future__ import annotations

import base64
import binascii
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote, unquote_to_bytes

from beltrami_cli.formats.model_folder import LEFT_OUTSIDE, UnfitReferenceError, checked_path, is_outside

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.entries import Entry
    from beltrami_cli.formats.model_folder import ModelFolder


def is_data(uri: str) -> bool:
    """Return whether a URI carries its bytes itself."""
    return uri[:5].lower() == "data:"


def data_uri(old: str, data: Bytes) -> str:
    """Return a data URI with the media type of an old one and new bytes, always base64."""
    head = old.partition(",")[0]
    head = head if head.lower().endswith(";base64") else head + ";base64"
    return f"{head},{base64.b64encode(data).decode('ascii')}"


def as_uri(name: str) -> str:
    """Return the URI of a relative path."""
    return quote(name)


def relative_name(uri: str, *, outside: bool = False) -> str:
    """Return the path that a URI names, percent-decoded, with "/"; UnfitReferenceError if it must not be followed."""
    name = unquote(uri)
    try:
        if "\\" in name or "\0" in name:
            raise UnfitReferenceError("is not a path as glTF spells it")
        return checked_path(name, outside=outside)
    except UnfitReferenceError as error:
        raise UnfitReferenceError(f"{_short(uri)} {error}") from None


def read(uri: str, folder: ModelFolder) -> bytes:
    """Return the bytes that a URI stands for, its own or those of a file; UnfitReferenceError if there are none."""
    if is_data(uri):
        return _embedded(uri)
    try:
        return folder.read(_located(uri, folder))
    except OSError as error:
        raise UnfitReferenceError(f"{_short(uri)} cannot be read ({error.strerror})") from None


def _embedded(uri: str) -> bytes:
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


def _located(uri: str, folder: ModelFolder) -> str:
    name = relative_name(uri, outside=folder.access.outside)
    try:
        return folder.locate(name)
    except UnfitReferenceError as error:
        raise UnfitReferenceError(f"{_short(uri)} {error}") from None


def _short(uri: str) -> str:
    return repr(uri if len(uri) <= 80 else uri[:77] + "...")


def files_beside(root: Entry, folder: ModelFolder) -> tuple[list[str], list[str]]:
    """Return the relative paths of named files that exist inside the folder, and a notice for every other."""
    names: dict[str, None] = {}
    notices: dict[str, None] = {}
    for entry, uri in _external(root):
        try:
            path = _located(uri, folder)
            if is_outside(path):
                notices[f"{entry.place}: {uri!r} {LEFT_OUTSIDE}"] = None
            else:
                names[path] = None
        except UnfitReferenceError as error:
            notices[f"{entry.place}: {error}."] = None
    return list(names), list(notices)


def named_files(root: Entry) -> set[str]:
    """Return the relative paths of all files that a glTF names, whether they exist or not."""
    names = set()
    for _, uri in _external(root):
        try:
            names.add(relative_name(uri))
        except UnfitReferenceError:
            continue  # not a name beside the file, so no output can overwrite it
    return names


def _external(root: Entry) -> Iterator[tuple[Entry, str]]:
    """Give the buffers and images that are files of their own, with their URIs."""
    for entry in [*root.entries("buffers"), *root.entries("images")]:
        uri = entry.text("uri")
        if uri is not None and not is_data(uri):
            yield entry, uri
