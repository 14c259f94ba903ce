"""A scene of polygons with materials, as readers fill it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int32s, Int64s
from beltrami_cli.errors import Obstacle
from beltrami_cli.surface.polygons import polygons_with
from beltrami_cli.surface.records import Material, Slot, Wrap
from beltrami_cli.surface.tiling import Tile

_UNREAD = Obstacle("cannot be read")


@dataclass(frozen=True)
class ShownMap:
    """The image that a material shows in a slot."""

    name: str  # as the file spells it
    path: str | None  # of an image or tile set; None: it is not read
    obstacle: Obstacle = _UNREAD  # why it is not read; follows the name in a message
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    alpha_hides: bool = True  # as in `Texture`
    tiles: Mapping[Tile, str] = field(default_factory=dict)  # files of a tile set


Maps = Mapping[Slot, ShownMap]


@dataclass(frozen=True)
class Scene:
    """The polygons of a file and their materials."""

    name: str  # of the file, for messages
    positions: Float64s  # (V, 3)
    corners: Int32s  # (K,): vertices of the corners of all polygons
    offsets: Int64s  # (P + 1,): first corner of each polygon
    material_of: Int64s  # (P,): index into `materials`
    materials: Sequence[Material]  # without their maps
    maps: Sequence[Maps]  # of each material
    # Texture coordinates of all corners, (K, 2), for a slot (None: for polygons without an image); NaN: none.
    uv: Callable[[Slot | None], Float64s]
    read: Callable[[str], bytes]
    measured: Bools | None = None  # (V,): which vertices have a finite position; None: all
    # Whether materials have factors for their maps and an alpha mode; otherwise these follow from the maps.
    has_factors: bool = False
    names: Mapping[str, str] = field(default_factory=dict)  # of images that are not files, by path
    is_v_up: bool = True
    notices: tuple[str, ...] = ()  # as in `ColouredVertices`

    def name_of(self, path: str) -> str:
        """Return the name of an image for messages."""
        return self.names.get(path, path.rpartition("/")[2])

    def uv_down(self, slot: Slot | None) -> Float64s:
        """Return texture coordinates as `uv`, v down."""
        return self.uv(slot) * [1, -1] + [0, 1] if self.is_v_up else self.uv(slot)

    @property
    def is_whole(self) -> Bools:
        """Polygons with at least three corners, all of them at finite positions."""
        is_whole = np.diff(self.offsets) >= 3
        if self.measured is not None:
            is_whole &= ~polygons_with(~self.measured[self.corners], self.offsets)
        return np.asarray(is_whole)
