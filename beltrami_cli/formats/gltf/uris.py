"""The URIs of a glTF file: data in themselves, or sidecar files."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Hashable
from contextlib import suppress
from urllib.parse import unquote, unquote_to_bytes

from beltrami_cli.errors import Obstacle
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.formats.sidecars.model_folder import (
    ModelFolder,
    UnfitReferenceError,
    checked_path,
    is_outside,
)


def is_data(uri: str) -> bool:
    """Whether a URI carries its bytes itself."""
    return uri[:5].lower() == "data:"


def data_uri(old: str, data: Bytes) -> str:
    """Return a data URI with the media type of an old one and new bytes, always base64."""
    head = old.partition(",")[0]
    head = head if head.lower().endswith(";base64") else head + ";base64"
    return f"{head},{base64.b64encode(data).decode('ascii')}"


def locate_uri(uri: str, folder: ModelFolder, *, must_exist: bool = True) -> str:
    """Return the path, relative to a folder, of the file that a URI names; UnfitReferenceError if it is not followed.

    Exporters write queries, such as "?v=3" against caches, and encode twice, so that a blank is "%2520".
    """
    bare, plain = re.split("[?#]", uri, maxsplit=1)[0], unquote(uri)
    names = dict.fromkeys((plain, unquote(bare), unquote(unquote(bare))))
    located = next((path for name in names if (path := folder.find(name)) is not None), None)
    if located is not None:
        return located
    if "\0" in plain:
        raise UnfitReferenceError("is not a path as glTF spells it")
    return folder.locate(plain) if must_exist else checked_path(plain, outside=True)


def read_uri(uri: str, folder: ModelFolder) -> bytes:
    """Return the bytes that a URI stands for, its own or a file's; UnfitReferenceError if there are none."""
    if not is_data(uri):
        try:
            return folder.read(locate_uri(uri, folder))
        except OSError as error:
            raise UnfitReferenceError(f"cannot be read ({error.strerror})") from None
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


def quoted_uri(uri: str) -> str:
    """Quote a URI for a message, shortened."""
    return repr(uri if len(uri) <= 80 else uri[:77] + "...")


class SidecarFiles:
    """The buffers and images of a glTF file that are separate files, by relative path."""

    def __init__(self, root: Entry, folder: ModelFolder) -> None:
        self.folder = folder
        self.any = False
        self.present: dict[str, None] = {}  # inside the folder
        self.missing: dict[str, None] = {}
        self.obstacles: dict[Obstacle, None] = {}  # of the missing ones
        for entry in [*root.entries("buffers"), *root.entries("images")]:
            uri = entry.text("uri")
            if uri is None or is_data(uri):
                continue
            self.any = True
            try:
                path = locate_uri(uri, folder)
                self.present |= {} if is_outside(path) else {path: None}
            except UnfitReferenceError as error:
                cause = f"{entry.place}: {quoted_uri(uri)} {error}"
                self.obstacles[Obstacle(cause, error.obstacle.remedy)] = None
                with suppress(UnfitReferenceError):
                    self.missing[locate_uri(uri, folder, must_exist=False)] = None


def file_key(uri: str | None, index: int, folder: ModelFolder) -> Hashable:
    """Return the key that identifies a stored file; the index for bytes that are in no file of their own."""
    with suppress(UnfitReferenceError):  # an error when its bytes are asked for
        if uri is not None and not is_data(uri):
            return locate_uri(uri, folder, must_exist=False)
    return index
