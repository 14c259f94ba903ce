"""Bytes of bufferViews that meshoptimizer has compressed: EXT_meshopt_compression and its successor by Khronos.

References
----------
.. [1] EXT_meshopt_compression and KHR_meshopt_compression, in the registry of glTF extensions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.buffers import Buffers
    from beltrami_cli.formats.gltf.tree import Entry

EXTENSIONS = ("KHR_meshopt_compression", "EXT_meshopt_compression")
"""The extensions of a bufferView; they say the same in the same words."""

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

_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")


@dataclass(frozen=True)
class Packed:
    """What the extension says of a bufferView.

    Attributes
    ----------
    entry : Entry
        The extension's JSON, for messages.
    extension : str
        Its name.
    buffer, offset, length : int
        Where the compressed bytes are.
    count, stride : int
        Elements, and bytes of each, when decompressed.
    mode, filter : str
        How they are compressed, and what was done to them before.
    """

    entry: Entry
    extension: str
    buffer: int
    offset: int
    length: int
    count: int
    stride: int
    mode: str
    filter: str


def read_packed(view: Entry, length: int, buffers: Buffers) -> Packed | None:
    """Read the extension of a bufferView; None if the view is not compressed.

    Parameters
    ----------
    view : Entry
        The bufferView.
    length : int
        Its byteLength, that is of what it means.
    buffers : Buffers
        All buffers.

    Raises
    ------
    InputError
        If the extension contradicts itself, the view or the buffers.
    """
    extensions = view.entry("extensions")
    extension = next((name for name in EXTENSIONS if name in extensions), None)
    if extension is None:
        return None
    entry = extensions.entry(extension)
    buffer = entry.integer("buffer", below=len(buffers))
    offset, packed = entry.integer("byteOffset", default=0), entry.integer("byteLength", least=1)
    if offset + packed > buffers.lengths[buffer]:
        raise entry.fault("", f"its bytes {offset} to {offset + packed} leave buffers[{buffer}]")
    count, stride = entry.integer("count", least=1), entry.integer("byteStride", least=1)
    mode, kind = entry.text("mode") or "", entry.text("filter") or "NONE"
    if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES"):
        raise entry.fault("mode", f"is {mode!r}, which {extension} does not define")
    if kind not in _FILTERS or (kind != "NONE" and mode != "ATTRIBUTES"):
        raise entry.fault("filter", f"is {kind!r}, which {extension} does not define for {mode}")
    if stride not in _STRIDES[mode] or (kind != "NONE" and stride not in _STRIDES[kind]):
        raise entry.fault("byteStride", f"is {stride}, which {extension} does not allow here")
    if count * stride != length:
        raise entry.fault("count", f"is {count}: {count * stride} bytes, but the view has {length}")
    return Packed(entry, extension, buffer, offset, packed, count, stride, mode, kind)


def unpacked(packed: Packed, data: Bytes) -> bytes:
    """Decompress the bytes of a view.

    Parameters
    ----------
    packed : Packed
        How they are compressed.
    data : bytes-like
        The buffer that `packed` names.

    Returns
    -------
    bytes
        ``count * stride`` of them.

    Raises
    ------
    InputError
        If they are damaged, or the package that decodes them is not installed.
    """
    library = _library(packed)
    source = bytes(data[packed.offset : packed.offset + packed.length])
    try:
        if packed.mode == "ATTRIBUTES":
            elements = library.decode_vertex_buffer(
                packed.count, packed.stride, source, np.dtype(f"V{packed.stride}")
            )
            return _unfiltered(library, packed, elements.view(np.uint8)).tobytes()
        decode = library.decode_index_buffer if packed.mode == "TRIANGLES" else library.decode_index_sequence
        indices: NDArray[np.uint32] = decode(packed.count, 4, source)
    except (RuntimeError, ValueError) as error:
        raise packed.entry.fault("", f"its compressed data is damaged ({error})") from None
    if packed.stride == 2 and indices.max() > np.iinfo(np.uint16).max:
        raise packed.entry.fault("byteStride", f"is 2, but there is an index {indices.max()}")
    return indices.astype(f"<u{packed.stride}").tobytes()


def repacked(packed: Packed, data: Bytes, old: Bytes) -> bytes:
    """Compress the bytes of a view of attributes again, without a filter and so without loss.

    Parameters
    ----------
    packed : Packed
        How they were compressed.
    data : bytes-like
        ``count * stride`` bytes.
    old : bytes-like
        The buffer that `packed` names, for the version of the encoding.

    Raises
    ------
    InputError
        If it is a view of indices, which cannot hold everything.
    """
    if packed.mode != "ATTRIBUTES":
        raise packed.entry.fault("mode", f"is {packed.mode}, which is not for vertex data")
    library = _library(packed)
    library.encode_vertex_version(old[packed.offset] & 0x0F)
    elements = np.frombuffer(data, np.uint8).reshape(packed.count, packed.stride)
    found: bytes = library.encode_vertex_buffer(elements, packed.count, packed.stride)
    return found


def _library(packed: Packed) -> Any:
    try:
        import meshoptimizer
    except ImportError:
        cause = f"to decode {packed.extension}, the package meshoptimizer is needed"
        raise packed.entry.fault("", cause, "install it with: pip install 'beltrami-cli[meshopt]'") from None
    return meshoptimizer


def _unfiltered(library: Any, packed: Packed, octets: NDArray[np.uint8]) -> NDArray[Any]:
    if packed.filter == "NONE":
        return octets
    if packed.filter == "COLOR":
        return _colours(octets.view("<u1" if packed.stride == 4 else "<u2").reshape(-1, 4))
    names = {"OCTAHEDRAL": "oct", "QUATERNION": "quat", "EXPONENTIAL": "exp"}
    decode = getattr(library, f"decode_filter_{names[packed.filter]}")
    found: NDArray[Any] = decode(octets, packed.count, packed.stride)
    return found


def _colours(stored: NDArray[Any]) -> NDArray[Any]:
    """Return red, green, blue and opacity of luma, two chromas and opacity, shape (n, 4).

    Notes
    -----
    All four have K bits; the highest bit of opacity says what K is, and stands for no opacity itself.
    """
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
