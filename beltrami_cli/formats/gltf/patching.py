"""New numbers put into the bytes and the JSON of a glTF file: in place where possible, else appended.

Numbers are overwritten where they are if nothing else uses their bytes. Otherwise a new bufferView at the end of
the buffer takes them, and only their accessor is pointed at it; no other view ever moves. Those that Draco has
compressed always get a view of their own, since the geometry would not survive another compression; views that
meshoptimizer has compressed are compressed again, which loses nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.accessors import Stored, element_bytes, quantised
from beltrami_cli.formats.gltf.columns import Column, colour_column
from beltrami_cli.formats.gltf.detaching import detach
from beltrami_cli.formats.gltf.editing import copied, point_at, update_bounds
from beltrami_cli.formats.gltf.sharing import alone, used_otherwise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.layouts import Layout
    from beltrami_cli.formats.gltf.surfaces import Block


def recolour(
    edit: Edit,
    blocks: Sequence[Block],
    stored: Sequence[Stored],
    old: NDArray[np.float32],
    new: NDArray[np.float32],
) -> None:
    """Put new colours into a file.

    Parameters
    ----------
    edit : Edit
        The changes so far, to which these are added.
    blocks : sequence of Block
        Its painted blocks.
    stored : sequence of ndarray, each of shape (rows of the block, 3 or 4)
        Their colours as stored.
    old, new : ndarray of float32, shape (V, 3)
        The colours of all rows before and after. Only entries that differ are written.

    Raises
    ------
    ValueError
        If `new` has another shape than `old`, or entries that are not finite.
    InputError
        If compressed colours cannot be replaced.
    """
    if new.shape != old.shape or not np.isfinite(new).all():
        raise ValueError(f"colours must be finite and of shape {old.shape}, not {new.shape}")
    numbers = []
    for block, before in zip(blocks, stored, strict=True):
        rows = slice(block.first_row, block.first_row + block.count)
        after = before.copy()
        differs = new[rows] != old[rows]
        after[:, :3][differs] = quantised(new[rows][differs], before.dtype)
        numbers.append((before, after))
    exchange(edit, [colour_column(block) for block in blocks], numbers)


def exchange(edit: Edit, columns: Sequence[Column], numbers: Sequence[tuple[Stored, Stored]]) -> None:
    """Put new numbers into a file. Views that are compressed are still to be compressed again.

    Parameters
    ----------
    edit : Edit
        The changes so far, to which these are added.
    columns : sequence of Column
        All columns of one attribute of the painted primitives.
    numbers : sequence of (ndarray, ndarray), each of shape (rows, width)
        Their numbers as stored, before and after.

    Raises
    ------
    InputError
        If compressed numbers cannot be replaced.
    """
    changes = [i for i, (before, after) in enumerate(numbers) if not np.array_equal(before, after)]
    if not changes:
        return
    in_place = alone(edit.container.tree, edit.accessors, columns)
    shared = used_otherwise(edit.container.tree, columns[0].attribute)
    for number in changes:
        column, (before, after) = columns[number], numbers[number]
        if edit.accessors.is_added(column.accessor):
            detach(edit, column, before, after)
            continue
        members = set(column.members) if in_place[number] else _own_accessors(edit.tree, column, shared)
        if in_place[number]:
            _overwrite(edit, column, after)
        else:
            view = edit.append_attribute(_home(edit, column), after)
            for index in members:
                point_at(edit.tree["accessors"][index], view)
        for index in members:
            update_bounds(edit.tree["accessors"][index], before, after)


def _overwrite(edit: Edit, column: Column, after: Stored) -> None:
    """Put numbers where they are; of a sparse accessor each where it is read, the elements that it replaces too."""
    accessor, rows = edit.accessors[column.accessor], edit.accessors.replaced(column.accessor)
    own, octets = np.ones(len(after), bool), after.view(np.uint8)
    own[rows] = False
    if accessor.sparse is not None:
        _elements(edit, accessor.sparse.values)[...] = octets[rows]
    if accessor.layout is not None:
        _elements(edit, accessor.layout)[own] = octets[own]
    elif octets[own].any():  # no more zeros
        view = edit.append_attribute(_home(edit, column), after)
        point_at(edit.tree["accessors"][column.accessor], view, keep_sparse=True)


def _elements(edit: Edit, layout: Layout) -> NDArray[np.uint8]:
    return element_bytes(edit.open(edit.accessors.buffers.canonical(layout.buffer)), layout)


def _own_accessors(tree: Tree, column: Column, shared: set[int]) -> set[int]:
    """Return accessors that only this attribute uses: those with other uses too are copied, the copies used."""
    copies: dict[int, int] = {}
    for index in sorted(column.members & shared):
        copies[index] = len(tree["accessors"])
        tree["accessors"].append(copied(tree["accessors"][index]))
    for mesh in tree["meshes"]:
        for primitive in mesh.get("primitives", []):
            attributes = primitive.get("attributes", {})
            if attributes.get(column.attribute) in copies:
                attributes[column.attribute] = copies[attributes[column.attribute]]
    return set(column.members - shared) | set(copies.values())


def _home(edit: Edit, column: Column) -> int:
    """Return the buffer that takes new numbers: that of the old ones, of the positions, or any with bytes."""
    accessor, position = edit.accessors[column.accessor], edit.accessors[column.position]
    layouts = [accessor.layout, accessor.sparse.values if accessor.sparse else None, position.layout]
    return edit.home(layout.buffer for layout in layouts if layout)
