"""New places of painted vertices put into a glTF file, with normals that fit them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.columns import Column
from beltrami_cli.formats.gltf.patching import exchange
from beltrami_cli.formats.gltf.primitives import identity

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors, Stored
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.surfaces import Block
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.surface.records import MovedVertices

_STALE = "The vertices moved, but their {} are as they were; make them anew, or leave them out."


def require_movable(accessors: Accessors, blocks: Sequence[Block]) -> None:
    """Check that positions can be replaced.

    Raises
    ------
    InputError
        If some are whole numbers, or compressed by Draco, or a node scales them to nothing.
    """
    for block in blocks:
        accessor = accessors[block.position]
        if accessors.is_added(block.position):
            remedy = "decompress the model first with a glTF optimiser"
            raise accessor.entry.fault("", "Draco positions cannot be replaced", remedy)
        if accessor.component.kind != "f":
            cause = f"positions are {accessor.component.name} (KHR_mesh_quantization), which cannot hold smoothed ones"
            raise accessor.entry.fault("componentType", cause, "store them as floats, with a glTF optimiser")
        if abs(np.linalg.det(block.placement.matrix[:3, :3])) < np.finfo(np.float64).tiny:
            raise accessor.entry.fault("", "its node scales the positions to nothing")


def move(edit: Edit, blocks: Sequence[Block], old: NDArray[np.float64], places: MovedVertices) -> None:
    """Put new positions and normals into a file.

    Parameters
    ----------
    edit : Edit
        The changes so far, to which these are added.
    blocks : sequence of Block
        Its painted blocks.
    old : ndarray of float64, shape (V, 3)
        The positions of all rows before.
    places : MovedVertices
        What is new. Only rows that differ are written.

    Raises
    ------
    InputError
        If parts that share positions would move apart.
    """
    moves = places.positions - old
    _exchange(edit, "POSITION", [(block, block.position) for block in blocks], _moved(moves))
    normals, stale = places.normals, set()
    if normals is not None:
        held = [(block, block.normal) for block in blocks if block.normal is not None]
        _exchange(edit, "NORMAL", held, _turned(normals))
    elif any(block.normal is not None for block in blocks):
        stale.add("normals")
    for primitive in _users(edit.container.root, blocks):
        if "TANGENT" in primitive.entry("attributes"):
            stale.add("tangents")
    edit.notices += [_STALE.format(what) for what in sorted(stale)]


def _moved(moves: NDArray[np.float64]) -> Callable[[Block, Stored], Stored]:
    def renew(block: Block, before: Stored) -> Stored:
        mine = moves[block.first_row : block.first_row + block.count]
        rows = mine.any(axis=1)
        back = np.linalg.inv(block.placement.matrix[:3, :3]).T
        after = before.copy()
        after[rows] = (before[rows].astype(np.float64) + mine[rows] @ back).astype(before.dtype)
        return after

    return renew


def _turned(normals: NDArray[np.float32]) -> Callable[[Block, Stored], Stored]:
    def renew(block: Block, before: Stored) -> Stored:
        mine = normals[block.first_row : block.first_row + block.count].astype(np.float64)
        rows = ~np.isnan(mine).any(axis=1)
        # Normals went to the common space by the inverse transpose.
        local = mine[rows] @ block.placement.matrix[:3, :3]
        local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        after = before.copy()
        if before.dtype.kind == "f":
            after[rows] = local
        else:
            after[rows] = np.rint(local * np.iinfo(before.dtype).max)
        return after

    return renew


def _exchange(
    edit: Edit,
    attribute: str,
    held: Sequence[tuple[Block, int]],
    renew: Callable[[Block, Stored], Stored],
) -> None:
    """Exchange an attribute of all blocks, which may share its numbers."""
    accessors, root = edit.accessors, edit.container.root
    columns: dict[Hashable, tuple[Column, Stored, Stored]] = {}
    for block, index in held:
        before = accessors.stored(index)
        after, key = renew(block, before), identity(accessors, index)
        if key not in columns:
            members = _members(root, accessors, attribute, key)
            column = Column(attribute, index, frozenset(members), tuple(block.users), block.position)
            columns[key] = column, before, after
            continue
        _, _, earlier = columns[key]
        mine, theirs = (after != before).any(axis=1), (earlier != before).any(axis=1)
        if attribute == "POSITION" and not np.array_equal(after[mine | theirs], earlier[mine | theirs]):
            cause = "is shared by parts that would move apart"
            raise accessors[index].entry.fault("", cause, "give each part positions of its own")
        earlier[mine] = after[mine]
    found = list(columns.values())
    exchange(edit, [column for column, _, _ in found], [(before, after) for _, before, after in found])


def _members(root: Entry, accessors: Accessors, attribute: str, key: Hashable) -> set[int]:
    """Return all accessors over certain numbers that primitives, painted or not, name as an attribute."""
    named = {
        primitive.entry("attributes").integer(attribute, below=len(accessors.all))
        for mesh in root.entries("meshes")
        for primitive in mesh.entries("primitives")
        if attribute in primitive.entry("attributes")
    }
    return {index for index in named if identity(accessors, index) == key}


def _users(root: Entry, blocks: Sequence[Block]) -> list[Entry]:
    meshes = root.entries("meshes")
    return [meshes[mesh].entries("primitives")[part] for block in blocks for mesh, part in block.users]
