"""The buffers of a glTF file and the views into them, the URIs of sidecar files: bytes are read when needed.

A bufferView may be compressed by meshoptimizer [1]_; its bytes are then a buffer of their own, decoded when needed.

References
----------
.. [1] EXT_meshopt_compression and KHR_meshopt_compression, in the registry of glTF extensions.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array
from beltrami_cli.errors import Obstacle, install_hint
from beltrami_cli.formats.access import is_too_dense
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.container import TRUNCATED, Container, Entry, Tree, objects, objects_within
from beltrami_cli.formats.model_folder import ModelFolder, UnfitReferenceError, checked_path, is_outside

MESHOPT = ("KHR_meshopt_compression", "EXT_meshopt_compression")
"""Extensions of a bufferView; both have the same members."""

_STRIDES = {
    "ATTRIBUTES": range(4, 257, 4),
    "TRIANGLES": (2, 4),
    "INDICES": (2, 4),
    "OCTAHEDRAL": (4, 8),
    "QUATERNION": (8,),
    "EXPONENTIAL": range(4, 257, 4),
    "COLOR": (4, 8),
}
"""Bytes of an element that each mode and each filter allows."""

_FILTERS = {"NONE": "", "OCTAHEDRAL": "oct", "QUATERNION": "quat", "EXPONENTIAL": "exp", "COLOR": ""}
"""Encodings of elements before their compression, with the names of the library's decoders."""


def is_data(uri: str) -> bool:
    """Whether a URI carries its bytes itself."""
    return uri[:5].lower() == "data:"


def data_uri(old: str, data: Bytes) -> str:
    """Return a data URI with the media type of an old one and new bytes, always base64."""
    head = old.partition(",")[0]
    head = head if head.lower().endswith(";base64") else head + ";base64"
    return f"{head},{base64.b64encode(data).decode('ascii')}"


def located(uri: str, folder: ModelFolder, *, must_exist: bool = True) -> str:
    """Return the path, relative to a folder, of the file that a URI names; UnfitReferenceError if it is not followed.

    Exporters write queries, such as "?v=3" against caches, and encode twice, so that a blank is "%2520".
    """
    bare, plain = re.split("[?#]", uri, maxsplit=1)[0], unquote(uri)
    names = dict.fromkeys((plain, unquote(bare), unquote(unquote(bare))))
    found = next((path for name in names if (path := folder.find(name)) is not None), None)
    if found is not None:
        return found
    if "\0" in plain:
        raise UnfitReferenceError("is not a path as glTF spells it")
    return folder.locate(plain) if must_exist else checked_path(plain, outside=True)


def read(uri: str, folder: ModelFolder) -> bytes:
    """Return the bytes that a URI stands for, its own or a file's; UnfitReferenceError if there are none."""
    if not is_data(uri):
        try:
            return folder.read(located(uri, folder))
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


def short(uri: str) -> str:
    """Quote a URI for a message, shortened."""
    return repr(uri if len(uri) <= 80 else uri[:77] + "...")


class SidecarFiles:
    """The buffers and images of a glTF file that are separate files, by relative path."""

    def __init__(self, root: Entry, folder: ModelFolder) -> None:
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
                path = located(uri, folder)
                self.present |= {} if is_outside(path) else {path: None}
            except UnfitReferenceError as error:
                cause = f"{entry.place}: {short(uri)} {error}"
                self.obstacles[Obstacle(cause, error.obstacle.remedy)] = None
                with suppress(UnfitReferenceError):
                    self.missing[located(uri, folder, must_exist=False)] = None


def file_key(uri: str | None, index: int, folder: ModelFolder) -> Hashable:
    """Return the key that identifies a stored file; the index for bytes that are in no file of their own."""
    with suppress(UnfitReferenceError):  # an error when its bytes are asked for
        if uri is not None and not is_data(uri):
            return located(uri, folder, must_exist=False)
    return index


@dataclass(frozen=True)
class Packed:
    """How meshoptimizer has compressed a bufferView."""

    entry: Entry  # the extension's JSON, for messages
    extension: str
    buffer: int
    offset: int  # of the compressed bytes, as is their length
    length: int
    count: int  # elements
    stride: int  # bytes of an element when decompressed
    mode: str
    filter: str  # encoding of the elements before their compression


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
                data: Bytes = read(uri, self._folder)
            except UnfitReferenceError as error:
                name = "" if is_data(uri) else f"{short(uri)} "
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
    """Read all bufferViews."""
    views = []
    for entry in root.entries("bufferViews"):
        buffer = entry.integer("buffer", below=len(buffers))
        offset, length = entry.integer("byteOffset", default=0), entry.integer("byteLength", least=1)
        if offset + length > buffers.lengths[buffer]:
            raise entry.fault("", f"its bytes {offset} to {offset + length} leave buffers[{buffer}]")
        stride = entry.integer("byteStride", least=1, below=1 << 16) if "byteStride" in entry else 0
        packed = _read_packed(entry, length, buffers.lengths)
        if packed is None:
            views.append(View(buffer, offset, length, stride))
        else:
            decoded = buffers.add(partial(unpacked, packed, buffers.stored))
            views.append(View(decoded, 0, length, stride, packed, (buffer, offset)))
    return views


def _read_packed(view: Entry, length: int, lengths: Sequence[int]) -> Packed | None:
    """Read how a bufferView of `length` bytes is compressed, None if it is not; `lengths` of all buffers."""
    extensions = view.entry("extensions")
    extension = next((name for name in MESHOPT if name in extensions), None)
    if extension is None:
        return None
    entry = extensions.entry(extension)
    buffer = entry.integer("buffer", below=len(lengths))
    offset, packed = entry.integer("byteOffset", default=0), entry.integer("byteLength", least=1)
    if offset + packed > lengths[buffer]:
        raise entry.fault("", f"its bytes {offset} to {offset + packed} leave buffers[{buffer}]")
    count, stride = entry.integer("count", least=1), entry.integer("byteStride", least=1)
    mode, kind = entry.text("mode") or "", entry.text("filter") or "NONE"
    if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES"):
        raise entry.fault("mode", f"is {mode!r}, which {extension} does not define")
    if kind not in _FILTERS or (kind != "NONE" and mode != "ATTRIBUTES"):
        raise entry.fault("filter", f"is {kind!r}, which {extension} does not define for {mode}")
    if stride not in _STRIDES[mode] or (kind != "NONE" and stride not in _STRIDES[kind]):
        raise entry.fault("byteStride", f"is {stride}, which {extension} does not allow here")
    if is_too_dense(packed, count * stride):
        raise entry.fault("count", f"is {count}: {count * stride} bytes in {packed}, more than any model has")
    if count * stride != length:
        raise entry.fault("count", f"is {count}: {count * stride} bytes, but the view has {length}")
    return Packed(entry, extension, buffer, offset, packed, count, stride, mode, kind)


def unpacked(packed: Packed, stored: Callable[[int], Bytes]) -> bytes:
    """Decompress the bytes of a view; `stored` gives the bytes of a buffer."""
    library, data = _library(packed), stored(packed.buffer)
    source = bytes(data[packed.offset : packed.offset + packed.length])
    try:
        if packed.mode == "ATTRIBUTES":
            kind = np.dtype(f"V{packed.stride}")
            octets = library.decode_vertex_buffer(packed.count, packed.stride, source, kind).view(np.uint8)
            if packed.filter == "COLOR":
                octets = _colours(octets.view("<u1" if packed.stride == 4 else "<u2").reshape(-1, 4))
            elif packed.filter != "NONE":
                unfilter = getattr(library, f"decode_filter_{_FILTERS[packed.filter]}")
                octets = np.asarray(unfilter(octets, packed.count, packed.stride))
            return bytes(octets.tobytes())
        decode = library.decode_index_buffer if packed.mode == "TRIANGLES" else library.decode_index_sequence
        indices: NDArray[np.uint32] = decode(packed.count, 4, source)
    except (RuntimeError, ValueError) as error:
        raise packed.entry.fault("", f"its compressed data is damaged ({error})") from None
    if packed.stride == 2 and indices.max() > np.iinfo(np.uint16).max:
        raise packed.entry.fault("byteStride", f"is 2, but there is an index {indices.max()}")
    return indices.astype(f"<u{packed.stride}").tobytes()


def repacked(packed: Packed, data: Bytes, old: Bytes) -> bytes:
    """Compress the bytes of vertex data again, without loss; `old` is the buffer, for the version of the encoding."""
    if packed.mode != "ATTRIBUTES":
        raise packed.entry.fault("mode", f"is {packed.mode}, which is not for vertex data")
    library = _library(packed)
    library.encode_vertex_version(old[packed.offset] & 0x0F)
    elements = np.frombuffer(data, np.uint8).reshape(packed.count, packed.stride)
    return bytes(library.encode_vertex_buffer(elements, packed.count, packed.stride))


def _library(packed: Packed) -> Any:
    try:
        import meshoptimizer
    except ImportError:
        cause = f"to decode {packed.extension}, the package meshoptimizer is needed"
        raise packed.entry.fault("", cause, install_hint("beltrami-cli[meshopt]")) from None
    return meshoptimizer


def _colours(stored: Array) -> Array:
    # All four have K bits; the highest bit of opacity says what K is, and stands for no opacity itself.
    bits = 8 * stored.dtype.itemsize
    luma, alpha = stored[:, 0].astype(np.int64), stored[:, 3].astype(np.int64)
    orange, green = stored[:, 1:3].view(f"<i{stored.dtype.itemsize}").astype(np.int64).T
    full = alpha
    for shift in (1, 2, 4, 8):
        full = full | full >> shift  # all ones below the highest one
    opacity = (alpha << 1 & full) | (alpha & 1)
    values = np.stack([luma + orange - green, luma + green, luma - orange - green, opacity], axis=1)
    # In single precision, as the decoders of viewers do.
    scale = np.float32(2**bits - 1) / np.maximum(full, 1).astype(np.float32)
    rounded = np.rint(values.astype(np.float32) * scale[:, None])
    return np.clip(rounded, 0, 2**bits - 1).astype(stored.dtype)


def named_places(tree: Tree, lengths: Sequence[int]) -> Iterator[tuple[tuple[int, str | None], View]]:
    """Yield the bytes that views and their extensions name, with the view's index and extension."""
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
    """Iterate over all members called "bufferView", in images and in unknown extensions too."""
    named = (each.get("bufferView") for each in objects_within(value))
    return (index for index in named if isinstance(index, int))
