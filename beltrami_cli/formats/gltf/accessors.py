"""The numbers of accessors: decoded from their bytes, and written back in their own component type."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.gltf.draco import DracoMeshes
from beltrami_cli.formats.gltf.layouts import Accessor, Layout, read_accessors, read_views

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.buffers import Buffers
    from beltrami_cli.formats.gltf.tree import Entry

# Corners, for all slots together: a byte is an index at least, and vertices take a dozen each.
_LEAST_DRAWN, _MOST_DRAWN = 1 << 20, 16

Stored = np.ndarray[Any, np.dtype[Any]]
"""Numbers as they are in the file: little-endian integers or float32."""


class Accessors:
    """All accessors of one file; descriptions are checked at once, bytes are read when asked for.

    Raises
    ------
    InputError
        If a description is wrong.

    Attributes
    ----------
    buffers : Buffers
        Where the bytes are.
    views : list of View
        The bufferViews.
    all : list of Accessor
        Those of the JSON. Higher indices are those that were decoded.
    draco : DracoMeshes
        What can be decoded besides.
    """

    def __init__(self, root: Entry, buffers: Buffers) -> None:
        self.buffers = buffers
        self.views = read_views(root, buffers)
        self.all = read_accessors(root, self.views)
        self.draco = DracoMeshes(self)
        self._added: list[Accessor] = []
        self._drawn = 0

    def __len__(self) -> int:
        return len(self.all)

    def __getitem__(self, index: int) -> Accessor:
        return self.all[index] if index < len(self.all) else self._added[index - len(self.all)]

    def add(self, described: Accessor, numbers: Stored) -> int:
        """Add an accessor for decoded numbers, shape (n, width), with another one's description; return its index."""
        octets = numbers.tobytes()
        buffer = self.buffers.add(len(octets), lambda: octets)
        size = numbers.dtype.itemsize * numbers.shape[1]
        layout = Layout(buffer, 0, size, size, len(numbers))
        self._added.append(
            replace(
                described, component=numbers.dtype, count=len(numbers), view=None, layout=layout, sparse=None
            )
        )
        return len(self.all) + len(self._added) - 1

    def is_added(self, index: int) -> bool:
        """Return whether an accessor is none of the JSON's, but decoded."""
        return index >= len(self.all)

    def count_drawn(self, primitive: Entry, corners: int) -> None:
        """Count the corners that primitives draw; small files can name the same ones without end.

        Raises
        ------
        InputError
            If all primitives together draw far more than there are bytes.
        """
        self._drawn += corners
        if self._drawn > _LEAST_DRAWN + _MOST_DRAWN * self.buffers.bytes_at_hand:
            cause = f"with it, {self._drawn} corners are drawn of {self.buffers.bytes_at_hand} bytes"
            raise primitive.fault("", cause, "the same triangles are used again and again: export each once")

    def require_bytes(self, index: int) -> None:
        """Load the buffer of an accessor, so that its count is known to be backed by bytes.

        Raises
        ------
        InputError
            If the bytes are missing; if it has none, when it has more elements than all files have bytes.
        """
        accessor = self[index]
        if accessor.layout is not None:
            self.buffers.stored(accessor.layout.buffer)
        elif accessor.count > self.buffers.bytes_at_hand:
            raise accessor.entry.fault("count", f"{accessor.count} zeros are more than the file has bytes")

    def stored(self, index: int) -> Stored:
        """Return the numbers as stored, sparse replacements applied.

        Returns
        -------
        ndarray of the component type, shape (count, width)

        Raises
        ------
        InputError
            If the bytes are missing or cannot be decoded, or sparse indices are not increasing and in range.
        """
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

    def replaced(self, index: int) -> NDArray[np.int64]:
        """Return the elements that a sparse accessor replaces, in order; none if it is not sparse.

        Raises
        ------
        InputError
            As `stored`.
        """
        accessor = self[index]
        if accessor.sparse is None:
            return np.empty(0, np.int64)
        rows = self._numbers(accessor.sparse.indices, accessor.sparse.index_type)[:, 0].astype(np.int64)
        if rows[-1] >= accessor.count or np.any(np.diff(rows) <= 0):
            raise accessor.entry.fault("sparse.indices", f"must increase and stay below {accessor.count}")
        return rows

    def values(self, index: int) -> NDArray[np.float64]:
        """Return the numbers that an accessor means, shape (count, width), integers decoded if normalised.

        Raises
        ------
        InputError
            As `stored`, and if a number is not finite.
        """
        accessor, stored = self[index], self.stored(index)
        if accessor.component.kind == "f" and not np.isfinite(stored).all():
            row = int(np.nonzero(~np.isfinite(stored).all(axis=1))[0][0])
            raise accessor.entry.fault("", f"element {row} is not finite", "repair the file")
        numbers = stored.astype(np.float64)
        if accessor.component.kind != "f" and accessor.normalised:
            numbers = np.maximum(numbers / np.iinfo(stored.dtype).max, -1.0)
        return numbers

    def _numbers(self, layout: Layout, component: np.dtype[Any]) -> Stored:
        octets = element_bytes(self.buffers.stored(layout.buffer), layout)
        return np.ascontiguousarray(octets).view(component)


def element_bytes(data: Bytes | NDArray[np.uint8], layout: Layout) -> NDArray[np.uint8]:
    """Return a view of the bytes of all elements, shape (count, size); writable if `data` is."""
    octets = data if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)
    octets = octets[layout.start : layout.end]
    if layout.start + len(octets) < layout.end:
        raise IndexError(f"{layout} leaves {len(data)} bytes")
    return np.lib.stride_tricks.as_strided(octets, (layout.count, layout.size), (layout.stride, 1))


def fractions(stored: Stored) -> NDArray[np.float32]:
    """Return colours as float32 with full scale 1: integers divided by their largest value.

    Notes
    -----
    Every uint8 and uint16 level comes back from `quantised` unchanged, since float32 holds 24 bits.
    """
    if stored.dtype.kind == "f":
        return stored.astype(np.float32)
    return (stored / np.float64(np.iinfo(stored.dtype).max)).astype(np.float32)


def quantised(values: NDArray[np.floating[Any]], component: np.dtype[Any]) -> Stored:
    """Return colours in a component type: integers clipped to [0, 1] and rounded once, to the nearest."""
    if component.kind == "f":
        return values.astype(component)
    return np.rint(np.clip(values.astype(np.float64), 0, 1) * np.iinfo(component).max).astype(component)
