"""Where the elements of accessors lie: descriptions checked against their views and buffers, no bytes read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.meshopt import Packed, read_packed, unpacked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.formats.gltf.buffers import Buffers
    from beltrami_cli.formats.gltf.tree import Entry

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy types of glTF's componentType."""

SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Components of one element by glTF's type."""


@dataclass(frozen=True)
class View:
    """A bufferView: `length` bytes from byte `offset` of a buffer; stride 0 means packed elements.

    Of a compressed view, these say where its bytes are once they are decoded; `packed` says how they are compressed,
    and `fallback` (a buffer and an offset) where the file may have them uncompressed.
    """

    buffer: int
    offset: int
    length: int
    stride: int
    packed: Packed | None = None
    fallback: tuple[int, int] | None = None


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
        """The byte after the last element."""
        return self.start + self.stride * (self.count - 1) + self.size


@dataclass(frozen=True)
class Sparse:
    """Replacements of some elements: which ones (`indices`, of the given type), and their `values`."""

    indices: Layout
    index_type: np.dtype[np.generic]
    values: Layout


@dataclass(frozen=True)
class Accessor:
    """A checked accessor.

    Attributes
    ----------
    entry : Entry
        Its JSON, for messages.
    component : numpy dtype
        Type of a component, little endian.
    width : int
        Components of one element.
    shape : str
        glTF's type: "SCALAR", "VEC3", ...
    count : int
        Elements.
    normalised : bool
        Whether integers stand for fractions of full scale.
    view : int or None
        Its bufferView.
    layout : Layout or None
        Where its elements lie; None if they are zeros (but for sparse ones).
    sparse : Sparse or None
        Replaced elements.
    """

    entry: Entry
    component: np.dtype[np.generic]
    width: int
    shape: str
    count: int
    normalised: bool
    view: int | None
    layout: Layout | None
    sparse: Sparse | None


def read_views(root: Entry, buffers: Buffers) -> list[View]:
    """Read all bufferViews.

    Raises
    ------
    InputError
        If one leaves its buffer, or is said to be compressed in a way that cannot be.
    """
    views = []
    for entry in root.entries("bufferViews"):
        buffer = entry.integer("buffer", below=len(buffers))
        offset, length = entry.integer("byteOffset", default=0), entry.integer("byteLength", least=1)
        if offset + length > buffers.lengths[buffer]:
            raise entry.fault("", f"its bytes {offset} to {offset + length} leave buffers[{buffer}]")
        stride = (
            entry.integer("byteStride", least=1, below=1 << 16, default=1) if "byteStride" in entry else 0
        )
        packed = read_packed(entry, length, buffers)
        if packed is None:
            views.append(View(buffer, offset, length, stride))
        else:
            decoded = buffers.add(length, partial(_decoded, packed, buffers))
            views.append(View(decoded, 0, length, stride, packed, (buffer, offset)))
    return views


def _decoded(packed: Packed, buffers: Buffers) -> bytes:
    return unpacked(packed, buffers.stored(packed.buffer))


def read_accessors(root: Entry, views: Sequence[View]) -> list[Accessor]:
    """Read all accessors.

    A stride need not be a multiple of four and elements need not be aligned: what the specification
    forbids there can still be read in only one way.

    Raises
    ------
    InputError
        If one is of an unknown type, leaves its view, or its elements overlap one another.
    """
    return [_accessor(entry, views) for entry in root.entries("accessors")]


def _accessor(entry: Entry, views: Sequence[View]) -> Accessor:
    component = _component(entry)
    shape = entry.text("type") or ""
    if shape not in SHAPES:
        raise entry.fault("type", f"is {shape!r}, which glTF does not define")
    count = entry.integer("count", least=1)
    index = entry.integer("bufferView", below=len(views)) if "bufferView" in entry else None
    size = _element_size(shape, component)
    layout = None if index is None else _layout(entry, views[index], index, size, count)
    sparse = _sparse(entry.entry("sparse"), views, size, count) if "sparse" in entry else None
    normalised = entry.flag("normalized")
    return Accessor(entry, component, SHAPES[shape], shape, count, normalised, index, layout, sparse)


def _component(entry: Entry) -> np.dtype[np.generic]:
    kind = entry.integer("componentType")
    if kind not in COMPONENTS:
        raise entry.fault("componentType", f"is {kind}, which glTF does not define")
    return np.dtype(COMPONENTS[kind])


def _element_size(shape: str, component: np.dtype[np.generic]) -> int:
    if not shape.startswith("MAT"):
        return SHAPES[shape] * component.itemsize
    side = int(shape[3])
    column = -(-side * component.itemsize // 4) * 4  # each column starts at a multiple of four bytes
    return side * column


def _layout(entry: Entry, view: View, index: int, size: int, count: int) -> Layout:
    offset = entry.integer("byteOffset", default=0)
    stride = view.stride or size
    if stride < size:
        raise entry.fault(
            "", f"its elements of {size} bytes overlap: bufferViews[{index}].byteStride is {stride}"
        )
    layout = Layout(view.buffer, view.offset + offset, stride, size, count)
    if layout.end > view.offset + view.length:
        needed = layout.end - view.offset
        raise entry.fault(
            "", f"{count} elements need {needed} bytes of bufferViews[{index}], which has {view.length}"
        )
    return layout


def _sparse(entry: Entry, views: Sequence[View], size: int, count: int) -> Sparse:
    replaced = entry.integer("count", least=1, below=count + 1)
    where, what = entry.entry("indices"), entry.entry("values")
    index_type = _component(where)
    if index_type.kind != "u":
        raise where.fault("componentType", "must be an unsigned integer type")
    first, second = (part.integer("bufferView", below=len(views)) for part in (where, what))
    return Sparse(
        _layout(where, views[first], first, index_type.itemsize, replaced),
        index_type,
        _layout(what, views[second], second, size, replaced),
    )
