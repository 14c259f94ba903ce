"""Views whose bytes meshoptimizer has compressed [1]_: their checks, and their bytes decoded and encoded.

References
----------
.. [1] EXT_meshopt_compression and KHR_meshopt_compression, in the registry of glTF extensions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array
from beltrami_cli.errors import install_hint
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.files.archives import is_too_dense
from beltrami_cli.formats.gltf.entries import Entry

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


def read_packed(view: Entry, length: int, lengths: Sequence[int]) -> Packed | None:
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
