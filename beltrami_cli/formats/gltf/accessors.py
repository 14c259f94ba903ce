"""Accessors: descriptions checked against their views, numbers decoded from bytes, and what primitives draw of them.

A stride need not be a multiple of four and elements need not be aligned: what the specification forbids there can
still be read in only one way. Draco [1]_ compresses whole primitives; their accessors are decoded when needed.

References
----------
.. [1] KHR_draco_mesh_compression, in the registry of glTF extensions.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s, Uint8s
from beltrami_cli.formats.document import Bytes
from beltrami_cli.formats.gltf.buffers import Buffers, View, read_views
from beltrami_cli.formats.gltf.container import Entry
from beltrami_cli.surface.geometry import unrolled
from beltrami_cli.surface.records import require_finite

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy types of glTF's componentType."""

SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Components of one element by glTF's type."""

DRACO = "KHR_draco_mesh_compression"  # extension of a primitive
_DRACO_MAGIC = b"DRACO"
_DRACO_MESH = b"\1"  # the kind of geometry, after the magic and the version

TRIANGLES, _STRIP, _FAN = 4, 5, 6  # drawing modes with faces; 0 to 3 are points and lines

# Corners, for all slots together: a byte is an index at least, and vertices take a dozen each.
_LEAST_DRAWN, _MOST_DRAWN = 1 << 20, 16

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


@dataclass(frozen=True)
class Accessor:
    """A checked accessor."""

    entry: Entry  # its JSON, for messages
    component: np.dtype[np.generic]
    width: int  # components of one element
    shape: str  # glTF's type: "SCALAR", "VEC3", ...
    count: int
    normalised: bool  # whether integers stand for fractions of full scale
    view: int | None
    layout: Layout | None  # None: all elements are zero, but for sparse ones
    sparse: Sparse | None


class Accessors:
    """All accessors of one file; descriptions are checked at once, bytes are read when asked for."""

    def __init__(self, root: Entry, buffers: Buffers) -> None:
        self.buffers = buffers
        self.views = read_views(root, buffers)
        self.all = [_accessor(entry, self.views) for entry in root.entries("accessors")]
        self._added: list[Accessor] = []  # decoded by Draco; their indices follow the JSON's
        self._decoded: dict[Hashable, int] = {}
        self._meshes: dict[int, Any] = {}
        self._drawn = 0
        self._root = root

    def __len__(self) -> int:
        return len(self.all)

    def __getitem__(self, index: int) -> Accessor:
        return self.all[index] if index < len(self.all) else self._added[index - len(self.all)]

    @cached_property
    def meshes(self) -> list[list[Primitive]]:
        """The primitives of every mesh."""
        return [
            [Primitive(each, self) for each in mesh.entries("primitives")]
            for mesh in self._root.entries("meshes")
        ]

    def is_added(self, index: int) -> bool:
        return index >= len(self.all)

    def decoded_attribute(self, packed: Entry, name: str, index: int) -> int:
        """Return the accessor of an attribute that Draco has compressed, which accessor `index` describes."""
        (view, mesh), accessor = self._draco(packed), self[index]
        number = packed.entry("attributes").integer(name)
        key = view, number, accessor.component.str, accessor.shape, accessor.normalised
        if key not in self._decoded:
            data = (each["data"] for each in mesh.attributes if each["unique_id"] == number)
            numbers = next(data, None)
            if numbers is None:
                cause = f"is {number}, but there is no such attribute in the data"
                raise packed.entry("attributes").fault(name, cause)
            self._decoded[key] = self._add(accessor, _fitted(np.asarray(numbers), accessor))
        return self._decoded[key]

    def decoded_indices(self, packed: Entry, index: int) -> int:
        """Return the accessor of triangles that Draco has compressed, which accessor `index` describes."""
        view, mesh = self._draco(packed)
        key = view, "faces"
        if key not in self._decoded:
            numbers = np.asarray(mesh.faces).astype("<u4").reshape(-1, 1)
            if not len(numbers):
                raise packed.fault("bufferView", "holds no triangles")
            accessor = replace(self[index], shape="SCALAR", width=1, normalised=False)
            self._decoded[key] = self._add(accessor, numbers)
        return self._decoded[key]

    def _draco(self, packed: Entry) -> tuple[int, Any]:
        """Return a view that Draco has compressed, and its mesh, which is decoded once."""
        view = packed.integer("bufferView", below=len(self.views))
        if view not in self._meshes:
            self._meshes[view] = _draco_mesh(packed, self.buffers.viewed(self.views[view]))
        return view, self._meshes[view]

    def _add(self, described: Accessor, numbers: Stored) -> int:
        """Add an accessor for decoded numbers, shape (n, width), with another one's description."""
        octets = numbers.tobytes()
        buffer = self.buffers.add(len(octets), lambda: octets)
        size, count = numbers.dtype.itemsize * numbers.shape[1], len(numbers)
        layout = Layout(buffer, 0, size, size, count)
        bare = replace(described, view=None, sparse=None)
        self._added.append(replace(bare, component=numbers.dtype, count=count, layout=layout))
        return len(self.all) + len(self._added) - 1

    def count_drawn(self, primitive: Entry, corners: int) -> None:
        """Count the corners that primitives draw, and refuse far more than bytes: small files can repeat them."""
        self._drawn += corners
        if self._drawn > _LEAST_DRAWN + _MOST_DRAWN * self.buffers.bytes_at_hand:
            cause = f"with it, {self._drawn} corners are drawn of {self.buffers.bytes_at_hand} bytes"
            raise primitive.fault("", cause, "the same triangles are used again and again: export each once")

    def require_bytes(self, index: int) -> None:
        """Load the buffer of an accessor, so that its count is known to be backed by bytes."""
        accessor = self[index]
        if accessor.layout is not None:
            self.buffers.stored(accessor.layout.buffer)
        elif accessor.count > self.buffers.bytes_at_hand:
            raise accessor.entry.fault("count", f"{accessor.count} zeros are more than the file has bytes")

    def stored(self, index: int) -> Stored:
        """Return the numbers as stored, shape (count, width), sparse replacements applied."""
        accessor = self[index]
        if accessor.layout is not None:
            numbers = self._numbers(accessor.layout, accessor.component)
        else:
            self.require_bytes(index)
            numbers = np.zeros((accessor.count, accessor.width), accessor.component)
        if accessor.sparse is not None:
            numbers = numbers.copy()  # it may be a view of the buffer
            numbers[self.replaced(index)] = self._numbers(accessor.sparse.values, accessor.component)
        return numbers

    def replaced(self, index: int) -> Int64s:
        """Return the elements that a sparse accessor replaces, in order; none if it is not sparse."""
        accessor = self[index]
        if accessor.sparse is None:
            return np.empty(0, np.int64)
        rows = self._numbers(accessor.sparse.indices, accessor.sparse.index_type)[:, 0].astype(np.int64)
        if rows[-1] >= accessor.count or np.any(np.diff(rows) <= 0):
            raise accessor.entry.fault("sparse.indices", f"must increase and stay below {accessor.count}")
        return rows

    def values(self, index: int) -> Float64s:
        """Return the finite numbers that an accessor means, shape (count, width), fractions where normalised."""
        accessor, stored = self[index], self.finite(index, "element")
        numbers = stored.astype(np.float64)
        if accessor.component.kind != "f" and accessor.normalised:
            numbers = np.maximum(numbers / np.iinfo(stored.dtype).max, -1.0)
        return numbers

    def finite(self, index: int, what: str) -> Stored:
        """Return the numbers as stored; `what` is the word for an element in the error if one is not finite."""
        stored, entry = self.stored(index), self[index].entry
        if stored.dtype.kind == "f":
            require_finite(stored, entry.name, f"{entry.place}: {what}")
        return stored

    def identity(self, index: int) -> Hashable:
        """Return the same for accessors that describe the same bytes in the same way."""
        accessor = self[index]
        if accessor.layout is None or accessor.sparse is not None:
            return index
        return accessor.layout, accessor.component.str, accessor.width, accessor.normalised

    def _numbers(self, layout: Layout, component: np.dtype[Any]) -> Stored:
        octets = element_bytes(self.buffers.stored(layout.buffer), layout)
        return np.ascontiguousarray(octets).view(component)


def _fitted(numbers: Array, accessor: Accessor) -> Stored:
    """Return decoded numbers, shape (n, width), in the type of their accessor."""
    if numbers.shape != (accessor.count, accessor.width):
        found = f"{numbers.shape[0]} elements of {numbers.shape[-1]} numbers"
        cause = f"is {accessor.count} of {accessor.width}, but {found} were decoded"
        raise accessor.entry.fault("count", cause)
    fitted = numbers.astype(accessor.component)
    if (numbers.dtype.kind == "f") != (fitted.dtype.kind == "f") or (
        numbers.dtype.kind != "f" and not np.array_equal(numbers, fitted)
    ):
        cause = f"does not fit the decoded numbers of {numbers.dtype.name}"
        raise accessor.entry.fault("componentType", cause)
    return fitted


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


def _accessor(entry: Entry, views: Sequence[View]) -> Accessor:
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
    return Accessor(entry, component, SHAPES[shape], shape, count, normalised, index, layout, sparse)


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


def _draco_mesh(packed: Entry, data: bytes) -> Any:
    try:
        import DracoPy
    except ImportError:
        cause = f"to decode {DRACO}, the package DracoPy is needed"
        raise packed.fault("", cause, "install it with: pip install 'beltrami-cli[draco]'") from None
    # Points could claim to be any number, and would be given the memory for it.
    if data[:5] == _DRACO_MAGIC and data[7:8] != _DRACO_MESH:
        raise packed.fault("bufferView", "holds points, not triangles")
    try:
        return DracoPy.decode(data)
    except (DracoPy.FileTypeException, TypeError, ValueError) as error:
        raise packed.fault("bufferView", f"holds damaged data ({error})") from None


class Primitive:
    """A primitive of a mesh; where Draco has compressed it, its accessors are the decoded ones."""

    def __init__(self, entry: Entry, accessors: Accessors) -> None:
        self.entry, self._accessors = entry, accessors
        self.attributes, extensions = entry.entry("attributes"), entry.entry("extensions")
        self.packed = extensions.entry(DRACO) if DRACO in extensions else None

    def __contains__(self, name: str) -> bool:
        return name in self.attributes

    def accessor(self, name: str) -> int:
        """Return the accessor of an attribute."""
        index = self.attributes.integer(name, below=len(self._accessors))
        if self.packed is None or name not in self.packed.entry("attributes"):
            return index
        return self._accessors.decoded_attribute(self.packed, name, index)

    def fitting(self, name: str, shape: str, count: int | None = None) -> int:
        """Return the accessor of an attribute: of a shape, of so many elements if it is said, and no large integers."""
        index = self.accessor(name)
        accessor = self._accessors[index]
        wanted = accessor.count if count is None else count
        if (accessor.shape, accessor.count) != (shape, wanted) or accessor.component.name == "uint32":
            cause = f"is {accessor.count} {accessor.shape} of {accessor.component.name}, not {wanted} {shape}"
            raise self.attributes.fault(name, cause)
        return index

    def position(self) -> int:
        """Return the accessor of positions, whose bytes are there."""
        index = self.fitting("POSITION", "VEC3")
        self._accessors.require_bytes(index)
        return index

    @property
    def mode(self) -> int:
        """The drawing mode of the indices: triangles if it is missing, or if strips were decoded."""
        mode = self.entry.integer("mode", below=7, default=TRIANGLES)
        return mode if self.packed is None else TRIANGLES

    @property
    def indices(self) -> int | None:
        if self.packed is None and "indices" not in self.entry:
            return None
        index = self.entry.integer("indices", below=len(self._accessors))
        return index if self.packed is None else self._accessors.decoded_indices(self.packed, index)

    def drawing_key(self) -> Hashable:
        """Return equal keys for primitives that draw their vertices in the same way."""
        return self.mode, None if self.indices is None else self._accessors.identity(self.indices)

    def triangles(self, count: int) -> Int64s:
        """Return the triangles, shape (F, 3), as vertex indices in [0, count), with glTF's winding."""
        index = self.indices
        self._accessors.count_drawn(self.entry, count if index is None else self._accessors[index].count)
        corners = np.arange(count)
        if index is not None:
            accessor = self._accessors[index]
            if accessor.shape != "SCALAR" or accessor.component.kind != "u":
                cause = f"is {accessor.shape} of {accessor.component.name}, not indices"
                raise self.entry.fault("indices", cause)
            corners = self._accessors.stored(index)[:, 0].astype(np.int64)
            if corners.max() >= count:
                cause = f"names vertex {corners.max()}, but there are only {count}"
                raise self.entry.fault("indices", cause)
        if self.mode == TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if self.mode == _STRIP:
            return unrolled(corners, np.array([0, len(corners)]))
        if self.mode != _FAN or len(corners) < 3:
            return np.empty((0, 3), np.int64)
        first = np.arange(len(corners) - 2)
        return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
