"""The buffers of a glTF file and the views into them; bytes are read when needed.

The bytes of a compressed bufferView are a buffer of their own, decoded when needed.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from typing import Literal

from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.container import TRUNCATED, Container
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.formats.gltf.meshopt import Packed, read_packed, unpacked
from beltrami_cli.formats.gltf.uris import file_key, is_data, quoted_uri, read_uri
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError

VERTEX_DATA, INDEX_DATA = 34962, 34963  # targets of views (ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER)


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


Source = Literal["chunk", "data", "file", "nowhere", "decoded"]
"""Where the bytes of a buffer are: in the BIN chunk, a data URI or a file, nowhere, or decoded from others."""


class Buffers:
    """All buffers of one file, then decoded ones; missing bytes are an error when asked for."""

    def __init__(self, container: Container, folder: ModelFolder) -> None:
        self._container, self._folder = container, folder
        self._entries = container.root.entries("buffers")
        self._loaded: dict[int, Bytes] = {}
        self._decoded: list[Callable[[], Bytes]] = []
        self.lengths = [entry.integer("byteLength", least=0) for entry in self._entries]
        self.uris = [entry.text("uri") for entry in self._entries]
        first: dict[Hashable, int] = {}
        keys = (file_key(uri, index, folder) for index, uri in enumerate(self.uris))
        self._canonical = [first.setdefault(key, index) for index, key in enumerate(keys)]

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, decode: Callable[[], Bytes]) -> int:
        """Add a buffer that is decoded when it is needed; return its index, behind the buffers of the JSON."""
        self._decoded.append(decode)
        return len(self) + len(self._decoded) - 1

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
            is_decoded = index >= len(self)
            self._loaded[index] = self._decoded[index - len(self)]() if is_decoded else self._read(index)
        return self._loaded[index]

    def _read(self, index: int) -> Bytes:
        entry, uri = self._entries[index], self.uris[index]
        if uri is not None:
            try:
                data: Bytes = read_uri(uri, self._folder)
            except UnfitReferenceError as error:
                name = "" if is_data(uri) else f"{quoted_uri(uri)} "
                raise entry.fault("uri", f"{name}{error}", error.obstacle.remedy) from None
        elif self.source(index) == "chunk":
            data = self._container.binary or b""
        else:
            raise entry.fault("", "has neither a uri nor a BIN chunk, so it has no bytes")
        if len(data) < self.lengths[index]:
            cause = f"is {self.lengths[index]}, but there are only {len(data)} bytes"
            raise entry.fault("byteLength", cause, TRUNCATED)
        return data

    def viewed(self, view: View) -> bytes:
        """Return the bytes of a view, decompressed."""
        return bytes(self.stored(view.buffer)[view.offset : view.end])

    @property
    def bytes_read(self) -> int:
        """Bytes of the main file and of all buffers that were read: the measure of what may be allocated."""
        return len(self._container.data) + sum(len(data) for data in self._loaded.values())


def read_views(root: Entry, buffers: Buffers) -> list[View]:
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
            decoded = buffers.add(partial(unpacked, packed, buffers.stored))
            views.append(View(decoded, 0, length, stride, packed, (buffer, offset)))
    return views
