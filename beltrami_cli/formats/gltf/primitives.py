"""What a primitive is made of: its positions, its triangles, and where its mesh stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.triangles import triangles

if TYPE_CHECKING:
    from collections.abc import Hashable

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.scene import Placement
    from beltrami_cli.formats.gltf.tree import Entry

DRACO = "KHR_draco_mesh_compression"


def require_uncompressed(primitive: Entry) -> None:
    """Raise an InputError if a primitive is compressed with Draco."""
    if DRACO in primitive.entry("extensions"):
        remedy = "decompress the model first with a glTF optimiser, and smooth the plain file"
        raise primitive.fault("extensions", f"{DRACO} is not decoded by beltrami", remedy)


def position_accessor(attributes: Entry, accessors: Accessors) -> int:
    """Return the accessor of positions.

    Raises
    ------
    InputError
        If it is missing, compressed, without its bytes, or not made of positions.
    """
    index = attributes.integer("POSITION", below=len(accessors))
    accessor = accessors[index]
    if accessor.shape != "VEC3" or accessor.component.name == "uint32":
        raise attributes.fault(
            "POSITION", f"is {accessor.shape} of {accessor.component.name}, not a position"
        )
    accessors.require_plain(index)
    accessors.require_bytes(index)
    return index


def index_accessor(primitive: Entry, accessors: Accessors) -> int | None:
    """Return the accessor of indices, None where vertices are drawn in their order."""
    return primitive.integer("indices", below=len(accessors)) if "indices" in primitive else None


def drawing_mode(primitive: Entry) -> int:
    """Return the drawing mode, triangles if it is not said."""
    return primitive.integer("mode", below=7, default=4)


def drawn(primitive: Entry, accessors: Accessors, count: int, placement: Placement) -> NDArray[np.int64]:
    """Return the triangles of a primitive as vertex indices in [0, count), shape (F, 3), facing outwards.

    Raises
    ------
    InputError
        If its indices are damaged.
    """
    index = index_accessor(primitive, accessors)
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
