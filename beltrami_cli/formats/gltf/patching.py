"""New colours put into the bytes and the JSON of a glTF file: in place where possible, else appended.

Colours are overwritten where they are if nothing else uses their bytes. Otherwise a new bufferView at the end of
the buffer takes them, and only their accessor is pointed at it; no other view ever moves.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.gltf.accessors import Accessors, Stored, element_bytes, quantised
from beltrami_cli.formats.gltf.files import re_embedded
from beltrami_cli.formats.gltf.sharing import alone, used_otherwise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.container import Container
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.surfaces import Block
    from beltrami_cli.mesh.textured import ImageFile

VERTEX_DATA = 34962
"""What a view is for (ARRAY_BUFFER)."""


@dataclass
class Edit:
    """What changes in a file.

    Attributes
    ----------
    container : Container
        The file.
    accessors : Accessors
        Its accessors and buffers, as they were.
    tree : dict
        The JSON with all changes but the URIs of buffers, which depend on where they are written.
    buffers : dict of int to bytearray
        New bytes of the buffers that change, longer than before if something was appended.
    pictures : dict of int to ImageFile
        New content of images that are files of their own, by their index in the new JSON.
    notices : list of str
        What the user should be told.
    """

    container: Container
    accessors: Accessors
    tree: Tree
    buffers: dict[int, bytearray] = field(default_factory=dict)
    pictures: dict[int, ImageFile] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)

    def open(self, index: int) -> bytearray:
        """Return the bytes of a buffer, to be changed."""
        if index not in self.buffers:
            self.buffers[index] = bytearray(self.accessors.buffers.stored(index))
        return self.buffers[index]


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
        members = block.members if in_place[number] else _own_accessors(edit.tree, block.members, shared)
        if in_place[number]:
            _overwrite(edit, block, after)
        else:
            _append(edit, block, members, after)
        for index in members:
            _update_bounds(edit.tree["accessors"][index], before, after)


def _overwrite(edit: Edit, block: Block, after: Stored) -> None:
    layout = edit.accessors[block.colour].layout
    if layout is None:
        raise AssertionError("colours without bytes cannot be overwritten")
    data = edit.open(edit.accessors.buffers.canonical(layout.buffer))
    element_bytes(data, layout)[...] = after.view(np.uint8)


def _own_accessors(tree: Tree, members: set[int], shared: set[int]) -> set[int]:
    """Return accessors that only COLOR_0 uses: those that have other uses too are copied, the copies used."""
    copies: dict[int, int] = {}
    for index in sorted(members & shared):
        copies[index] = len(tree["accessors"])
        tree["accessors"].append(_copied(tree["accessors"][index]))
    for mesh in tree["meshes"]:
        for primitive in mesh.get("primitives", []):
            attributes = primitive.get("attributes", {})
            if attributes.get("COLOR_0") in copies:
                attributes["COLOR_0"] = copies[attributes["COLOR_0"]]
    return (members - shared) | set(copies.values())


def _copied(accessor: Tree) -> Tree:
    return {key: list(value) if isinstance(value, list) else value for key, value in accessor.items()}


def _append(edit: Edit, block: Block, members: set[int], after: Stored) -> None:
    """Put the colours into a new view at the end of their buffer and point their accessors at it."""
    buffer = _home(edit, block)
    size = after.dtype.itemsize * after.shape[1]
    stride = -(-size // 4) * 4  # vertex attributes start at multiples of four bytes
    octets = np.zeros((len(after), stride), np.uint8)
    octets[:, :size] = np.ascontiguousarray(after).view(np.uint8)
    data = edit.open(buffer)
    data += bytes(-len(data) % 4)
    view = {"buffer": buffer, "byteOffset": len(data), "byteLength": octets.size, "target": VERTEX_DATA}
    if stride != size:
        view["byteStride"] = stride
    views = edit.tree.setdefault("bufferViews", [])
    views.append(view)
    data += octets.tobytes()
    edit.tree["buffers"][buffer]["byteLength"] = len(data)
    for index in members:
        accessor = edit.tree["accessors"][index]
        accessor["bufferView"] = len(views) - 1
        accessor.pop("sparse", None)
        if "byteOffset" in accessor:
            accessor["byteOffset"] = 0


def _home(edit: Edit, block: Block) -> int:
    """Return the buffer that takes new colours: that of the old ones, of the positions, or any with bytes."""
    buffers = edit.accessors.buffers
    accessor = edit.accessors[block.colour]
    layouts = [
        accessor.layout,
        accessor.sparse.values if accessor.sparse else None,
        edit.accessors[block.position].layout,
    ]
    for layout in layouts:
        if layout is not None:
            return buffers.canonical(layout.buffer)
    for index in range(len(buffers)):
        if buffers.source(index) != "nowhere":
            return buffers.canonical(index)
    index = len(edit.tree.setdefault("buffers", []))
    if index not in edit.buffers:
        edit.tree["buffers"].append(
            {"byteLength": 0, "uri": re_embedded("data:application/octet-stream,", b"")}
        )
        edit.buffers[index] = bytearray()
    return index


def _update_bounds(accessor: Tree, before: Stored, after: Stored) -> None:
    """Renew those components of min and max, if they are there, whose true value changes."""
    for key, reduce in (("min", np.min), ("max", np.max)):
        bounds: Any = accessor.get(key)
        if isinstance(bounds, list) and len(bounds) == after.shape[1]:
            was, now = reduce(before, axis=0), reduce(after, axis=0)
            for component in np.nonzero(was != now)[0]:
                bounds[component] = now[component].item()
