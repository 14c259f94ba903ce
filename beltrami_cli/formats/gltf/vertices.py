"""New colours, positions and normals of painted vertices put into a glTF file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.accessors import Accessors, Stored, quantised
from beltrami_cli.formats.gltf.columns import Column, exchange

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.formats.gltf.edit import Edit
    from beltrami_cli.formats.gltf.entries import Entry
    from beltrami_cli.formats.gltf.painted import Block
    from beltrami_cli.surface.records import MovedVertices

_STALE = "The vertices moved, but their {} are as they were; make them anew, or leave them out."


def recolour(
    edit: Edit, blocks: Sequence[Block], stored: Sequence[Stored], old: Float32s, new: Float32s
) -> None:
    """Put new colours (V, 3) into a file; `stored` are those of each block, and only entries that differ change."""
    if new.shape != old.shape or not np.isfinite(new).all():
        raise ValueError(f"colours must be finite and of shape {old.shape}, not {new.shape}")
    columns, numbers = [], []
    for block, before in zip(blocks, stored, strict=True):
        rows = slice(block.first_row, block.first_row + block.count)
        after = before.copy()
        differs = new[rows] != old[rows]
        after[:, :3][differs] = quantised(new[rows][differs], before.dtype)
        columns.append(_column("COLOR_0", block.colour, block.members, block))
        numbers.append((before, after))
    exchange(edit, columns, numbers)


def _column(attribute: str, index: int, members: set[int], block: Block) -> Column:
    return Column(attribute, index, frozenset(members), tuple(block.users), block.position)


def require_movable(accessors: Accessors, blocks: Sequence[Block]) -> None:
    """Check that positions can be replaced: floats, not compressed by Draco, and not scaled to nothing."""
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


def move(edit: Edit, blocks: Sequence[Block], old: Float64s, places: MovedVertices) -> None:
    """Put new positions, and normals if there are any, into a file; only rows that differ from `old` are written."""
    moves = places.positions - old
    _exchange_shared(edit, "POSITION", [(block, block.position) for block in blocks], _moved(moves))
    normals, stale = places.normals, set()
    if normals is not None:
        held = [(block, block.normal) for block in blocks if block.normal is not None]
        _exchange_shared(edit, "NORMAL", held, _turned(normals))
    elif any(block.normal is not None for block in blocks):
        stale.add("normals")
    meshes = edit.container.root.entries("meshes")
    for mesh, part in (user for block in blocks for user in block.users):
        if "TANGENT" in meshes[mesh].entries("primitives")[part].entry("attributes"):
            stale.add("tangents")
    edit.notices += [_STALE.format(what) for what in sorted(stale)]


def _moved(moves: Float64s) -> Callable[[Block, Stored], Stored]:
    def renew(block: Block, before: Stored) -> Stored:
        mine = moves[block.first_row : block.first_row + block.count]
        rows = mine.any(axis=1)
        back = np.linalg.inv(block.placement.matrix[:3, :3]).T
        after = before.copy()
        after[rows] = (before[rows].astype(np.float64) + mine[rows] @ back).astype(before.dtype)
        return after

    return renew


def _turned(normals: Float32s) -> Callable[[Block, Stored], Stored]:
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


def _exchange_shared(
    edit: Edit, attribute: str, held: Sequence[tuple[Block, int]], renew: Callable[[Block, Stored], Stored]
) -> None:
    """Exchange an attribute of all blocks, which may share its numbers."""
    accessors, root = edit.accessors, edit.container.root
    columns: dict[Hashable, tuple[Column, Stored, Stored]] = {}
    for block, index in held:
        before = accessors.stored(index)
        after, key = renew(block, before), accessors.identity(index)
        if key not in columns:
            members = _members(root, accessors, attribute, key)
            columns[key] = _column(attribute, index, members, block), before, after
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
    return {index for index in named if accessors.identity(index) == key}
