"""What a primitive is made of: its positions, its triangles, and where its mesh stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.draco import packed_in
from beltrami_cli.formats.gltf.triangles import TRIANGLES, triangles

if TYPE_CHECKING:
    from collections.abc import Hashable

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.scene import Placement
    from beltrami_cli.formats.gltf.tree import Entry


def attribute_accessor(primitive: Entry, name: str, accessors: Accessors) -> int:
    """Return the accessor of an attribute, the decoded one if the primitive is compressed.

    Raises
    ------
    InputError
        If it is missing, or cannot be decoded.
    """
    index = primitive.entry("attributes").integer(name, below=len(accessors))
    packed = packed_in(primitive)
    if packed is None or name not in packed.entry("attributes"):
        return index
    return accessors.draco.attribute(packed, name, index)


def position_accessor(primitive: Entry, accessors: Accessors) -> int:
    """Return the accessor of positions.

    Raises
    ------
    InputError
        If it is missing, cannot be decoded, is without its bytes, or not made of positions.
    """
    index = attribute_accessor(primitive, "POSITION", accessors)
    accessor = accessors[index]
    if accessor.shape != "VEC3" or accessor.component.name == "uint32":
        cause = f"is {accessor.shape} of {accessor.component.name}, not a position"
        raise primitive.entry("attributes").fault("POSITION", cause)
    accessors.require_bytes(index)
    return index


def index_accessor(primitive: Entry, accessors: Accessors) -> int | None:
    """Return the accessor of indices, None where vertices are drawn in their order.

    Raises
    ------
    InputError
        If they are missing though they are compressed, or cannot be decoded.
    """
    packed = packed_in(primitive)
    if packed is not None:
        return accessors.draco.indices(packed, primitive.integer("indices", below=len(accessors)))
    return primitive.integer("indices", below=len(accessors)) if "indices" in primitive else None


def drawing_mode(primitive: Entry) -> int:
    """Return the drawing mode of the indices: triangles if it is not said, or if strips were decoded."""
    mode = primitive.integer("mode", below=7, default=TRIANGLES)
    return mode if packed_in(primitive) is None else TRIANGLES


def drawn(primitive: Entry, accessors: Accessors, count: int, placement: Placement) -> NDArray[np.int64]:
    """Return the triangles of a primitive as vertex indices in [0, count), shape (F, 3), facing outwards.

    Raises
    ------
    InputError
        If its indices are damaged.
    """
    index = index_accessor(primitive, accessors)
    accessors.count_drawn(primitive, count if index is None else accessors[index].count)
    corners = np.arange(count) if index is None else _indices(primitive, accessors, index, count)
    faces = triangles(drawing_mode(primitive), corners)
    if np.linalg.det(placement.matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]  # a mirrored node turns its triangles inside out
    return faces


def _indices(primitive: Entry, accessors: Accessors, index: int, count: int) -> NDArray[np.int64]:
    accessor = accessors[index]
    if accessor.shape != "SCALAR" or accessor.component.kind != "u":
        raise primitive.fault("indices", f"is {accessor.shape} of {accessor.component.name}, not indices")
    corners = accessors.stored(index)[:, 0].astype(np.int64)
    if corners.max() >= count:
        raise primitive.fault("indices", f"names vertex {corners.max()}, but there are only {count}")
    return corners


def identity(accessors: Accessors, index: int) -> Hashable:
    """Return the same for accessors that describe the same bytes in the same way."""
    accessor = accessors[index]
    if accessor.layout is None or accessor.sparse is not None:
        return index
    return accessor.layout, accessor.component.str, accessor.width, accessor.normalised


def in_world(
    positions: NDArray[np.float64], placement: Placement, accessors: Accessors, index: int
) -> NDArray[np.float64]:
    """Return positions of an accessor, shape (n, 3), in the common space.

    Raises
    ------
    InputError
        If they overflow.
    """
    matrix = placement.matrix
    with np.errstate(over="ignore", invalid="ignore"):
        moved: NDArray[np.float64] = positions @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(moved).all():
        raise accessors[index].entry.fault("", "positions overflow in world space")
    return moved
