"""The buffers of a glTF file and the views into them, the URIs of sidecar files: bytes are read when needed."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal
from urllib.parse import unquote, unquote_to_bytes

from beltrami_cli.formats import model_folder
from beltrami_cli.formats.document import Bytes
from beltrami_cli.formats.gltf.compression import Packed, read_packed, unpacked
from beltrami_cli.formats.gltf.container import Container
from beltrami_cli.formats.gltf.json_tree import Entry, Tree, objects, objects_within


def is_data(uri: str) -> bool:
    """Return whether a URI carries its bytes itself."""
    return uri[:5].lower() == "data:"


def data_uri(old: str, data: Bytes) -> str:
    """Return a data URI with the media type of an old one and new bytes, always base64."""
    head = old.partition(",")[0]
    head = head if head.lower().endswith(";base64") else head + ";base64"
    return f"{head},{base64.b64encode(data).decode('ascii')}"


def relative_name(uri: str, folder: model_folder.ModelFolder, *, outside: bool = False) -> str:
    """Return the path that a URI names, whether or not a file is there; UnfitReferenceError if it is not followed."""
    with suppress(model_folder.UnfitReferenceError):
        return located(uri, folder)
    return _checked(uri, unquote(uri), lambda name: model_folder.checked_path(name, outside=outside))


def located(uri: str, folder: model_folder.ModelFolder) -> str:
    """Return the path, relative to a folder, of the file that a URI names; UnfitReferenceError if there is none.

    Exporters write queries, such as "?v=3" against caches, and encode twice, so that a blank is "%2520".
    """
    bare = re.split("[?#]", uri, maxsplit=1)[0]
    names = dict.fromkeys((unquote(uri), unquote(bare), unquote(unquote(bare))))
    found = next((path for name in names if (path := folder.find(name)) is not None), None)
    return found if found is not None else _checked(uri, unquote(uri), folder.locate)


def _checked(uri: str, name: str, check: Callable[[str], str]) -> str:
    try:
        if "\0" in name:
            raise model_folder.UnfitReferenceError("is not a path as glTF spells it")
        return check(name)
    except model_folder.UnfitReferenceError as error:
        raise model_folder.UnfitReferenceError(f"{_short(uri)} {error}") from None


def read(uri: str, folder: model_folder.ModelFolder) -> bytes:
    """Return the bytes that a URI stands for, its own or a file's; UnfitReferenceError if there are none."""
    if is_data(uri):
        return _embedded(uri)
    try:
        return folder.read(located(uri, folder))
    except OSError as error:
        raise model_folder.UnfitReferenceError(f"{_short(uri)} cannot be read ({error.strerror})") from None


def _embedded(uri: str) -> bytes:
    head, comma, payload = uri.partition(",")
    if not comma:
        raise model_folder.UnfitReferenceError("is a data URI without a comma")
    octets = unquote_to_bytes(payload)
    if not head.lower().endswith(";base64"):
        return octets
    try:
        return base64.b64decode(octets + b"=" * (-len(octets) % 4), validate=True)
    except binascii.Error as error:
        raise model_folder.UnfitReferenceError(f"is a data URI with damaged base64 ({error})") from None


def _short(uri: str) -> str:
    return repr(uri if len(uri) <= 80 else uri[:77] + "...")


def files_beside(root: Entry, folder: model_folder.ModelFolder) -> tuple[list[str], list[str]]:
    """Return the relative paths of named files that exist inside the folder, and a notice for each that does not."""
    names: dict[str, None] = {}
    notices: dict[str, None] = {}
    for entry, uri in _external(root):
        try:
            path = located(uri, folder)
            if not model_folder.is_outside(path):
                names[path] = None
        except model_folder.UnfitReferenceError as error:
            notices[f"{entry.place}: {error}."] = None
    return list(names), list(notices)


def named_files(root: Entry, folder: model_folder.ModelFolder) -> set[str]:
    """Return the relative paths of all files that a glTF names, whether they exist or not."""
    names = set()
    for _, uri in _external(root):
        try:
            names.add(relative_name(uri, folder))
        except model_folder.UnfitReferenceError:
            continue  # not a name in the file's folder, so no output can overwrite it
    return names


def file_key(uri: str | None, index: int, folder: model_folder.ModelFolder) -> Hashable:
    """Return the same for all that one file is named for; what has bytes of its own is known by its index."""
    try:
        if uri is not None and not is_data(uri):
            return relative_name(uri, folder, outside=folder.access.outside)
    except model_folder.UnfitReferenceError:
        pass  # an error when its bytes are asked for
    return index


def _external(root: Entry) -> Iterator[tuple[Entry, str]]:
    """Give the buffers and images that are files of their own, with their URIs."""
    for entry in [*root.entries("buffers"), *root.entries("images")]:
        uri = entry.text("uri")
        if uri is not None and not is_data(uri):
            yield entry, uri


Source = Literal["chunk", "data", "file", "nowhere", "decoded"]
"""Where the bytes of a buffer are: in the BIN chunk, a data URI or a file, nowhere, or decoded from others."""


class Buffers:
    """All buffers of one file, then decoded ones; missing bytes are an error when asked for."""

    def __init__(self, container: Container, folder: model_folder.ModelFolder) -> None:
        self._container, self._folder = container, folder
        self._entries = container.root.entries("buffers")
        self._loaded: dict[int, Bytes] = {}
        self._decoded: list[tuple[int, Callable[[], Bytes]]] = []
        self.lengths = [entry.integer("byteLength", least=0) for entry in self._entries]
        self.uris = [entry.text("uri") for entry in self._entries]
        first: dict[Hashable, int] = {}
        keys = (file_key(uri, index, folder) for index, uri in enumerate(self.uris))
        self._canonical = [first.setdefault(key, index) for index, key in enumerate(keys)]

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, length: int, decode: Callable[[], Bytes]) -> int:
        """Add a buffer whose bytes are made when they are asked for; its number is beyond the JSON's."""
        self._decoded.append((length, decode))
        return len(self) + len(self._decoded) - 1

    def length(self, index: int) -> int:
        return self.lengths[index] if index < len(self) else self._decoded[index - len(self)][0]

    def canonical(self, index: int) -> int:
        """Return the first buffer that is the same file as this one, usually itself."""
        return self._canonical[index] if index < len(self) else index

    def source(self, index: int) -> Source:
        if index >= len(self):
            return "decoded"
        uri = self.uris[index]
        if uri is not None:
            return "data" if is_data(uri) else "file"
        return "chunk" if index == 0 and self._container.binary is not None else "nowhere"

    def stored(self, index: int) -> Bytes:
        """Return all bytes of a buffer, at least as many as its byteLength says (padding may follow)."""
        if index not in self._loaded:
            is_made = index >= len(self)
            self._loaded[index] = self._decoded[index - len(self)][1]() if is_made else self._read(index)
        return self._loaded[index]

    def _read(self, index: int) -> Bytes:
        entry, uri = self._entries[index], self.uris[index]
        if uri is not None:
            try:
                data: Bytes = read(uri, self._folder)
            except model_folder.UnfitReferenceError as error:
                raise entry.fault("uri", str(error), model_folder.remedy_for(str(error))) from None
        elif self.source(index) == "chunk":
            data = self._container.binary or b""
        else:
            raise entry.fault("", "has neither a uri nor a BIN chunk, so it has no bytes")
        if len(data) < self.lengths[index]:
            cause = f"is {self.lengths[index]}, but there are only {len(data)} bytes"
            raise entry.fault("byteLength", cause, "the file may be cut short: copy or export it again")
        return data

    def viewed(self, view: View) -> bytes:
        """Return the bytes of a view, decompressed."""
        return bytes(self.stored(view.buffer)[view.offset : view.end])

    @property
    def bytes_at_hand(self) -> int:
        """Bytes of the main file and of all buffers that were read: the measure of what may be allocated."""
        return len(self._container.data) + sum(len(data) for data in self._loaded.values())


@dataclass(frozen=True)
class View:
    """A bufferView; of a compressed one, where its bytes are once they are decoded."""

    buffer: int
    offset: int
    length: int
    stride: int = 0  # 0: elements without gaps
    packed: Packed | None = None
    fallback: tuple[int, int] | None = None  # buffer and offset of the bytes uncompressed, if there are any

    @property
    def end(self) -> int:
        return self.offset + self.length


def read_views(root: Entry, buffers: Buffers) -> list[View]:
    """Read all bufferViews."""
    views = []
    for entry in root.entries("bufferViews"):
        buffer = entry.integer("buffer", below=len(buffers))
        offset, length = entry.integer("byteOffset", default=0), entry.integer("byteLength", least=1)
        if offset + length > buffers.lengths[buffer]:
            raise entry.fault("", f"its bytes {offset} to {offset + length} leave buffers[{buffer}]")
        stride = entry.integer("byteStride", least=1, below=1 << 16) if "byteStride" in entry else 0
        packed = read_packed(entry, length, buffers.lengths)
        if packed is None:
            views.append(View(buffer, offset, length, stride))
        else:
            decoded = buffers.add(length, partial(unpacked, packed, buffers.stored))
            views.append(View(decoded, 0, length, stride, packed, (buffer, offset)))
    return views


def named_places(tree: Tree, lengths: Sequence[int]) -> Iterator[tuple[tuple[int, str | None], View]]:
    """Give the bytes that views and their extensions name, with the view's index and extension."""
    for index, view in enumerate(objects(tree.get("bufferViews"))):
        for name, holder in [(None, view), *view.get("extensions", {}).items()]:
            if not isinstance(holder, dict):
                continue
            buffer, offset, length = (holder.get(key, 0) for key in ("buffer", "byteOffset", "byteLength"))
            if isinstance(buffer, int) and isinstance(offset, int) and isinstance(length, int):
                inside = 0 <= buffer < len(lengths) and offset >= 0 and length > 0
                if "buffer" in holder and inside and offset + length <= lengths[buffer]:
                    yield (index, name), View(buffer, offset, length)


def named_views(value: object) -> Iterator[int]:
    """Give every member called "bufferView", in images and in extensions that we do not know."""
    named = (each.get("bufferView") for each in objects_within(value))
    return (index for index in named if isinstance(index, int))
