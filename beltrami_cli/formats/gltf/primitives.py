"""The primitives of a glTF file: their attributes, and the triangles that they draw."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from beltrami_cli.arrays import Int64s
from beltrami_cli.formats.gltf.accessors import Accessor, Accessors
from beltrami_cli.formats.gltf.draco import DRACO, Draco
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.surface.polygons import unrolled

TRIANGLES, _STRIP, _FAN = 4, 5, 6  # drawing modes with faces; 0 to 3 are points and lines
# The attribute of vertex colours of textured meshes: COLOR_0 would be multiplied with the texture.
OWN_COLOURS = "_COLOR_0"


class Primitive:
    """A primitive of a mesh; where Draco has compressed it, its accessors are the decoded ones."""

    def __init__(self, entry: Entry, accessors: Accessors, draco: Draco) -> None:
        self.entry, self._accessors, self._draco = entry, accessors, draco
        self.attributes, extensions = entry.entry("attributes"), entry.entry("extensions")
        self.packed = extensions.entry(DRACO) if DRACO in extensions else None

    def __contains__(self, name: str) -> bool:
        return name in self.attributes

    def accessor(self, name: str) -> Accessor:
        accessor = self._accessors[self.attributes.integer(name, below=len(self._accessors))]
        if self.packed is None or name not in self.packed.entry("attributes"):
            return accessor
        return self._draco.attribute(self.packed, name, accessor)

    def fitting(self, name: str, shape: str, count: int | None = None) -> Accessor:
        """Return an attribute: of a shape, of so many elements if it is said, and no large integers."""
        accessor = self.accessor(name)
        wanted = accessor.count if count is None else count
        if (accessor.shape, accessor.count) != (shape, wanted) or accessor.component.name == "uint32":
            cause = f"is {accessor.count} {accessor.shape} of {accessor.component.name}, not {wanted} {shape}"
            raise self.attributes.fault(name, cause)
        return accessor

    def position(self) -> Accessor:
        """Return the positions, whose bytes are there."""
        accessor = self.fitting("POSITION", "VEC3")
        accessor.require_bytes()
        return accessor

    @property
    def mode(self) -> int:
        """The drawing mode of the indices: triangles if it is missing, or if strips were decoded."""
        mode = self.entry.integer("mode", below=7, default=TRIANGLES)
        return mode if self.packed is None else TRIANGLES

    @property
    def indices(self) -> Accessor | None:
        if self.packed is None and "indices" not in self.entry:
            return None
        accessor = self._accessors[self.entry.integer("indices", below=len(self._accessors))]
        return accessor if self.packed is None else self._draco.indices(self.packed, accessor)

    def drawing_key(self) -> Hashable:
        """Return equal keys for primitives that draw their vertices in the same way."""
        return self.mode, self.indices and self.indices.identity

    def triangles(self, count: int) -> Int64s:
        """Return the triangles, shape (F, 3), as vertex indices in [0, count), with glTF's winding.

        Each call counts towards the limit of `Accessors.count_drawn`.
        """
        indices = self.indices
        self._accessors.count_drawn(self.entry, count if indices is None else indices.count)
        corners = np.arange(count)
        if indices is not None:
            if indices.shape != "SCALAR" or indices.component.kind != "u":
                cause = f"is {indices.shape} of {indices.component.name}, not indices"
                raise self.entry.fault("indices", cause)
            corners = indices.stored()[:, 0].astype(np.int64)
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


Meshes = Sequence[Sequence[Primitive]]
"""The primitives of every mesh."""


def read_meshes(root: Entry, accessors: Accessors) -> Meshes:
    draco = Draco(accessors)
    return [
        [Primitive(each, accessors, draco) for each in mesh.entries("primitives")]
        for mesh in root.entries("meshes")
    ]
