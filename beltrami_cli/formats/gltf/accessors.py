"""Accessors: descriptions checked against their views, and numbers decoded from bytes.

A stride need not be a multiple of four and elements need not be aligned: what the specification forbids there can
still be read in only one way.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s, Uint8s
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.buffers import Buffers, View, read_views
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.surface.precision import require_finite

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy types of glTF's componentType."""

SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Components of one element by glTF's type."""

MAX_ROWS = np.iinfo(np.int32).max  # vertices and colours of a file, whose indices are int32
# Corners, for all slots together: a byte is an index at least, and vertices take a dozen each.
_MIN_DRAWN, _MAX_DRAWN = 1 << 20, 16

Stored = np.ndarray[Any, np.dtype[Any]]  # numbers as they are in the file: little-endian integers or float32


@dataclass(frozen=True)
class Layout:
    """Elements of `size` bytes each, `stride` bytes apart, from byte `start` of a buffer."""

    buffer: int
    start: int
    stride: int
    size: int
    count: int

    @property
    def end(self) -> int:
        return self.start + self.stride * (self.count - 1) + self.size


@dataclass(frozen=True)
class Sparse:
    """Replacements of some elements: which ones (`indices`, of the given type), and their `values`."""

    indices: Layout
    index_type: np.dtype[np.generic]
    values: Layout


@dataclass(frozen=True, eq=False)
class Accessor:
    """A checked accessor, whose bytes are read when they are asked for."""

    entry: Entry  # its JSON, for messages
    buffers: Buffers
    component: np.dtype[np.generic]
    width: int  # components of one element
    shape: str  # glTF's type: "SCALAR", "VEC3", ...
    count: int
    normalised: bool  # whether integers stand for fractions of full scale
    view: int | None
    layout: Layout | None  # None: all elements are zero, but for sparse ones
    sparse: Sparse | None
    is_decoded: bool = False  # by Draco

    @property
    def layouts(self) -> list[Layout]:
        """Where the numbers lie: the elements, and sparse ones that replace some of them."""
        both = self.layout, self.sparse.values if self.sparse else None
        return [layout for layout in both if layout is not None]

    @property
    def identity(self) -> Hashable:
        """The same for accessors that describe the same bytes in the same way."""
        if self.layout is None or self.sparse is not None:
            return self.entry.place
        return self.layout, self.component.str, self.width, self.normalised

    def require_bytes(self) -> None:
        """Load the buffer, so that the count is known to be backed by bytes."""
        if self.layout is not None:
            self.buffers.stored(self.layout.buffer)
        elif self.count > self.buffers.bytes_read:
            raise self.entry.fault("count", f"{self.count} zeros are more than the file has bytes")

    def stored(self) -> Stored:
        """Return the numbers as stored, shape (count, width), sparse replacements applied."""
        self.require_bytes()
        if self.layout is not None:
            numbers = self._numbers(self.layout, self.component)
        else:
            numbers = np.zeros((self.count, self.width), self.component)
        if self.sparse is not None:
            numbers = numbers.copy()  # it may be a view of the buffer
            numbers[self.replaced()] = self._numbers(self.sparse.values, self.component)
        return numbers

    def replaced(self) -> Int64s:
        """Return the elements that a sparse accessor replaces, in order; none if it is not sparse."""
        if self.sparse is None:
            return np.empty(0, np.int64)
        rows = self._numbers(self.sparse.indices, self.sparse.index_type)[:, 0].astype(np.int64)
        if rows[-1] >= self.count or np.any(np.diff(rows) <= 0):
            raise self.entry.fault("sparse.indices", f"must increase and stay below {self.count}")
        return rows

    def values(self) -> Float64s:
        """Return the finite numbers that are meant, shape (count, width), fractions where normalised."""
        stored = self.finite("element")
        numbers = stored.astype(np.float64)
        if self.component.kind != "f" and self.normalised:
            numbers = np.maximum(numbers / np.iinfo(stored.dtype).max, -1.0)
        return numbers

    def finite(self, what: str) -> Stored:
        """Return the numbers as stored; `what` is the word for an element in the error if one is not finite."""
        stored = self.stored()
        if stored.dtype.kind == "f":
            require_finite(stored, self.entry.name, f"{self.entry.place}: {what}")
        return stored

    def _numbers(self, layout: Layout, component: np.dtype[Any]) -> Stored:
        octets = element_bytes(self.buffers.stored(layout.buffer), layout)
        return np.ascontiguousarray(octets).view(component)


class Accessors:
    """All accessors of one file; descriptions are checked at once."""

    def __init__(self, root: Entry, buffers: Buffers) -> None:
        self.buffers = buffers
        self.views = read_views(root, buffers)
        self.all = [_accessor(entry, self.views, buffers) for entry in root.entries("accessors")]
        self._drawn = 0

    def __len__(self) -> int:
        return len(self.all)

    def __getitem__(self, index: int) -> Accessor:
        return self.all[index]

    def count_drawn(self, primitive: Entry, corners: int) -> None:
        """Count the corners that primitives draw, and refuse far more than bytes: small files can repeat them."""
        self._drawn += corners
        if self._drawn > _MIN_DRAWN + _MAX_DRAWN * self.buffers.bytes_read:
            cause = f"with it, {self._drawn} corners are drawn of {self.buffers.bytes_read} bytes"
            raise primitive.fault("", cause, "the same triangles are used again and again: export each once")


def element_bytes(data: Bytes | Uint8s, layout: Layout) -> Uint8s:
    """Return a view of the bytes of all elements, shape (count, size); writable if `data` is."""
    octets = data if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)
    octets = octets[layout.start : layout.end]
    if layout.start + len(octets) < layout.end:
        raise IndexError(f"{layout} leaves {len(data)} bytes")
    return np.lib.stride_tricks.as_strided(octets, (layout.count, layout.size), (layout.stride, 1))


def padded_elements(numbers: Stored) -> tuple[Uint8s, int]:
    """Return the bytes of elements (n, width), each padded to a multiple of four, and their size without padding."""
    size = numbers.dtype.itemsize * numbers.shape[1]
    octets = np.zeros((len(numbers), -(-size // 4) * 4), np.uint8)
    octets[:, :size] = np.ascontiguousarray(numbers).view(np.uint8)
    return octets, size


def fractions(stored: Stored) -> Float32s:
    """Return colours as float32 with full scale 1; `quantised` gives every uint8 and uint16 level back unchanged."""
    if stored.dtype.kind == "f":
        return stored.astype(np.float32)
    return (stored / np.float64(np.iinfo(stored.dtype).max)).astype(np.float32)


def _accessor(entry: Entry, views: Sequence[View], buffers: Buffers) -> Accessor:
    component = _component(entry)
    shape = entry.text("type") or ""
    if shape not in SHAPES:
        raise entry.fault("type", f"is {shape!r}, which glTF does not define")
    count = entry.integer("count", least=1)
    index = entry.integer("bufferView", below=len(views)) if "bufferView" in entry else None
    size = SHAPES[shape] * component.itemsize
    if shape.startswith("MAT"):
        # Each column starts at a multiple of four bytes.
        side = int(shape[3])
        size = side * (-(-side * component.itemsize // 4) * 4)
    layout = None if index is None else _layout(entry, views[index], index, size, count)
    sparse = _sparse(entry.entry("sparse"), views, size, count) if "sparse" in entry else None
    normalised = entry.flag("normalized")
    return Accessor(entry, buffers, component, SHAPES[shape], shape, count, normalised, index, layout, sparse)


def _component(entry: Entry) -> np.dtype[np.generic]:
    kind = entry.integer("componentType")
    if kind not in COMPONENTS:
        raise entry.fault("componentType", f"is {kind}, which glTF does not define")
    return np.dtype(COMPONENTS[kind])


def _layout(entry: Entry, view: View, index: int, size: int, count: int) -> Layout:
    offset = entry.integer("byteOffset", default=0)
    stride = view.stride or size
    if stride < size:
        cause = f"its elements of {size} bytes overlap: bufferViews[{index}].byteStride is {stride}"
        raise entry.fault("", cause)
    layout = Layout(view.buffer, view.offset + offset, stride, size, count)
    if layout.end > view.offset + view.length:
        needed = layout.end - view.offset
        cause = f"{count} elements need {needed} bytes of bufferViews[{index}], which has {view.length}"
        raise entry.fault("", cause)
    return layout


def _sparse(entry: Entry, views: Sequence[View], size: int, count: int) -> Sparse:
    replaced = entry.integer("count", least=1, below=count + 1)
    where, what = entry.entry("indices"), entry.entry("values")
    index_type = _component(where)
    if index_type.kind != "u":
        raise where.fault("componentType", "must be an unsigned integer type")
    first, second = (part.integer("bufferView", below=len(views)) for part in (where, what))
    indices = _layout(where, views[first], first, index_type.itemsize, replaced)
    return Sparse(indices, index_type, _layout(what, views[second], second, size, replaced))
