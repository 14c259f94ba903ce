"""Numbers that Draco has compressed, replaced by plain ones: the rest of the compressed geometry stays as it is.

Encoding a mesh anew would move its vertices and change their order. So the compressed data is not touched; the
primitive only says no more that these numbers are in there, and their accessor gets bytes of its own, in the order in
which decoders give the vertices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.draco import EXTENSION, packed_in
from beltrami_cli.formats.gltf.editing import copied, point_at, update_bounds
from beltrami_cli.formats.gltf.sharing import objects, used_otherwise

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.accessors import Stored
    from beltrami_cli.formats.gltf.columns import Column
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.tree import Entry


def detach(edit: Edit, column: Column, before: Stored, after: Stored) -> None:
    """Store the numbers of a column outside the compressed data.

    Parameters
    ----------
    edit : Edit
        The changes so far, to which these are added.
    column : Column
        What was decoded.
    before, after : ndarray, shape (rows, width)
        Its numbers as stored.

    Raises
    ------
    InputError
        If the file has the geometry uncompressed, too, with its vertices in another order.
    """
    users = [_primitive(edit, *user) for user in column.users]
    for user in users:
        _require_same_order(edit, user, column.attribute)
    packed = users[0].entry("extensions").entry(EXTENSION)
    source = edit.accessors.views[packed.integer("bufferView")]
    view = edit.append_attribute(edit.home([source.buffer]), after)
    own = _own_accessors(edit, column)
    for mesh, part in column.users:
        primitive = edit.tree["meshes"][mesh]["primitives"][part]
        primitive["attributes"][column.attribute] = own[primitive["attributes"][column.attribute]]
        del primitive["extensions"][EXTENSION]["attributes"][column.attribute]
    for index in set(own.values()):
        point_at(edit.tree["accessors"][index], view)
        update_bounds(edit.tree["accessors"][index], before, after)


def _primitive(edit: Edit, mesh: int, part: int) -> Entry:
    return edit.container.root.entries("meshes")[mesh].entries("primitives")[part]


def _require_same_order(edit: Edit, primitive: Entry, attribute: str) -> None:
    """Raise an InputError if viewers that do not decode Draco would give the numbers to other vertices."""
    accessors, index = edit.accessors, primitive.integer("indices")
    packed = packed_in(primitive)
    if packed is None or accessors[primitive.entry("attributes").integer(attribute)].layout is None:
        return
    plain, decoded = accessors.stored(index), accessors.stored(accessors.draco.indices(packed, index))
    if not np.array_equal(plain, decoded):
        cause = "holds vertices in another order than the uncompressed geometry beside it"
        raise packed.fault("bufferView", cause, "remove one of the two, and smooth the other")


def _own_accessors(edit: Edit, column: Column) -> dict[int, int]:
    """Return for each accessor of the numbers one that nothing else uses: itself, or a copy."""
    tree, users = edit.container.tree, set(column.users)
    others = used_otherwise(tree, column.attribute)
    named = set()
    for mesh, holder in enumerate(objects(tree.get("meshes"))):
        for part, primitive in enumerate(objects(holder.get("primitives"))):
            index = primitive["attributes"].get(column.attribute)
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
