"""New colours put into the bytes and the JSON of a glTF file: in place where possible, else appended.

Colours are overwritten where they are if nothing else uses their bytes. Otherwise a new bufferView at the end of
the buffer takes them, and only their accessor is pointed at it; no other view ever moves. Those that Draco has
compressed always get a view of their own, since the geometry would not survive another compression; views that
meshoptimizer has compressed are compressed again, which loses nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.accessors import Stored, element_bytes, quantised
from beltrami_cli.formats.gltf.detaching import detach
from beltrami_cli.formats.gltf.editing import copied, point_at, update_bounds
from beltrami_cli.formats.gltf.recompressing import compress_again
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
    changes = []
    for number, (block, before) in enumerate(zip(blocks, stored, strict=True)):
        rows = slice(block.first_row, block.first_row + block.count)
        after = before.copy()
        differs = new[rows] != old[rows]
        after[:, :3][differs] = quantised(new[rows][differs], before.dtype)
        if not np.array_equal(after, before):
            changes.append((number, before, after))
    in_place = alone(edit.container.tree, edit.accessors, blocks) if changes else []
    shared = used_otherwise(edit.container.tree)
    for number, before, after in changes:
        block = blocks[number]
        if edit.accessors.is_added(block.colour):
            detach(edit, block, before, after)
            continue
        members = block.members if in_place[number] else _own_accessors(edit.tree, block.members, shared)
        if in_place[number]:
            _overwrite(edit, block, after)
        else:
            _append(edit, block, members, after)
        for index in members:
            update_bounds(edit.tree["accessors"][index], before, after)
    compress_again(edit)


def _overwrite(edit: Edit, block: Block, after: Stored) -> None:
    """Put the colours where they are; of a sparse accessor each where it is read, the elements that it replaces too."""
    accessor, rows = edit.accessors[block.colour], edit.accessors.replaced(block.colour)
    own, octets = np.ones(len(after), bool), after.view(np.uint8)
    own[rows] = False
    if accessor.sparse is not None:
        _elements(edit, accessor.sparse.values)[...] = octets[rows]
    if accessor.layout is not None:
        _elements(edit, accessor.layout)[own] = octets[own]
    elif octets[own].any():  # no more zeros
        view = edit.append_attribute(_home(edit, block), after)
        point_at(edit.tree["accessors"][block.colour], view, keep_sparse=True)


def _elements(edit: Edit, layout: Layout) -> NDArray[np.uint8]:
    return element_bytes(edit.open(edit.accessors.buffers.canonical(layout.buffer)), layout)


def _own_accessors(tree: Tree, members: set[int], shared: set[int]) -> set[int]:
    """Return accessors that only COLOR_0 uses: those that have other uses too are copied, the copies used."""
    copies: dict[int, int] = {}
    for index in sorted(members & shared):
        copies[index] = len(tree["accessors"])
        tree["accessors"].append(copied(tree["accessors"][index]))
    for mesh in tree["meshes"]:
        for primitive in mesh.get("primitives", []):
            attributes = primitive.get("attributes", {})
            if attributes.get("COLOR_0") in copies:
                attributes["COLOR_0"] = copies[attributes["COLOR_0"]]
    return (members - shared) | set(copies.values())


def _append(edit: Edit, block: Block, members: set[int], after: Stored) -> None:
    """Put the colours into a new view at the end of their buffer and point their accessors at it."""
    view = edit.append_attribute(_home(edit, block), after)
    for index in members:
        point_at(edit.tree["accessors"][index], view)


def _home(edit: Edit, block: Block) -> int:
    """Return the buffer that takes new colours: that of the old ones, of the positions, or any with bytes."""
    accessor, position = edit.accessors[block.colour], edit.accessors[block.position]
    layouts = [accessor.layout, accessor.sparse.values if accessor.sparse else None, position.layout]
    return edit.home(layout.buffer for layout in layouts if layout)
