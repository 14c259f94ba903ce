"""Colours that Draco has compressed, replaced by plain ones: the rest of the compressed geometry stays as it is.

Encoding a mesh anew would move its vertices and change their order. So the compressed data is not touched; the
primitive only says no more that its colours are in there, and its accessor gets bytes of its own, in the order in which
decoders give the vertices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.draco import EXTENSION, packed_in
from beltrami_cli.formats.gltf.editing import copied, point_at, update_bounds
from beltrami_cli.formats.gltf.sharing import objects, used_otherwise

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.accessors import Stored
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.surfaces import Block
    from beltrami_cli.formats.gltf.tree import Entry


def detach(edit: Edit, block: Block, before: Stored, after: Stored) -> None:
    """Store the colours of a block outside its compressed data.

    Parameters
    ----------
    edit : Edit
        The changes so far, to which these are added.
    block : Block
        What is painted; its colours were decoded.
    before, after : ndarray, shape (rows of the block, 3 or 4)
        Its colours as stored.

    Raises
    ------
    InputError
        If the file has the geometry uncompressed, too, with its vertices in another order.
    """
    users = [_primitive(edit, *user) for user in block.users]
    for user in users:
        _require_same_order(edit, user)
    packed = users[0].entry("extensions").entry(EXTENSION)
    source = edit.accessors.views[packed.integer("bufferView")]
    view = edit.append_attribute(edit.home([source.buffer]), after)
    own = _own_accessors(edit, block)
    for mesh, part in block.users:
        primitive = edit.tree["meshes"][mesh]["primitives"][part]
        primitive["attributes"]["COLOR_0"] = own[primitive["attributes"]["COLOR_0"]]
        del primitive["extensions"][EXTENSION]["attributes"]["COLOR_0"]
    for index in set(own.values()):
        point_at(edit.tree["accessors"][index], view)
        update_bounds(edit.tree["accessors"][index], before, after)


def _primitive(edit: Edit, mesh: int, part: int) -> Entry:
    return edit.container.root.entries("meshes")[mesh].entries("primitives")[part]


def _require_same_order(edit: Edit, primitive: Entry) -> None:
    """Raise an InputError if viewers that do not decode Draco would give the colours to other vertices."""
    accessors, index = edit.accessors, primitive.integer("indices")
    packed = packed_in(primitive)
    if packed is None or accessors[primitive.entry("attributes").integer("COLOR_0")].layout is None:
        return
    plain, decoded = accessors.stored(index), accessors.stored(accessors.draco.indices(packed, index))
    if not np.array_equal(plain, decoded):
        cause = "holds vertices in another order than the uncompressed geometry beside it"
        raise packed.fault("bufferView", cause, "remove one of the two, and smooth the other")


def _own_accessors(edit: Edit, block: Block) -> dict[int, int]:
    """Return for each accessor of the colours one that nothing else uses: itself, or a copy."""
    tree, users = edit.container.tree, set(block.users)
    others = used_otherwise(tree)
    named = set()
    for mesh, holder in enumerate(objects(tree.get("meshes"))):
        for part, primitive in enumerate(objects(holder.get("primitives"))):
            index = primitive["attributes"].get("COLOR_0")
            if (mesh, part) in users:
                named.add(index)
            elif index is not None:
                others.add(index)
    own = {}
    for index in sorted(named):
        own[index] = index
        if index in others:
            own[index] = len(edit.tree["accessors"])
            edit.tree["accessors"].append(copied(edit.tree["accessors"][index]))
    return own
