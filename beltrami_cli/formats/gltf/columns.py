"""New numbers of vertex attributes put into a glTF file: in place where possible, else appended.

Numbers are overwritten where they are if nothing else uses their bytes. Otherwise a new bufferView at the end of
the buffer takes them, and only their accessor is pointed at it; no other view ever moves.

Attributes that Draco has compressed always get a view of their own, in the order in which decoders give the vertices:
encoding a mesh again would move its vertices and change their order. The compressed data stays as it is; the primitive
just does not name these numbers in it any more. Views that meshoptimizer has compressed are compressed again, which
loses nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.formats.gltf.accessors import Accessors, Layout, Stored, element_bytes
from beltrami_cli.formats.gltf.buffers import View, named_places, named_views
from beltrami_cli.formats.gltf.compression import DRACO, draco_extension
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.json_tree import Entry, Tree, objects, primitives_of


@dataclass(frozen=True)
class Column:
    """Numbers of one vertex attribute that painted primitives share."""

    attribute: str  # "COLOR_0", "POSITION" or "NORMAL"
    accessor: int  # where they are read
    members: Set[int]  # all accessors over these numbers that primitives name as this attribute
    users: Collection[tuple[int, int]]  # painted primitives that do: mesh, and index in the mesh
    position: int  # accessor of the positions that they belong to


def exchange(edit: Edit, columns: Sequence[Column], numbers: Sequence[tuple[Stored, Stored]]) -> None:
    """Put new numbers into a file: all columns of one attribute, with their numbers (rows, width) before and after."""
    changes = [i for i, (before, after) in enumerate(numbers) if not np.array_equal(before, after)]
    if not changes:
        return
    in_place = _alone(edit.container.tree, edit.accessors, columns)
    shared = used_otherwise(edit.container.tree, columns[0].attribute)
    for number in changes:
        column, (before, after) = columns[number], numbers[number]
        if edit.accessors.is_added(column.accessor):
            _detach(edit, column, before, after)
            continue
        members: Collection[int] = column.members
        if in_place[number]:
            _overwrite(edit, column, after)
        else:
            members = _own_accessors(edit, column.attribute, column.members, shared).values()
            view = edit.append_attribute(_buffer_for(edit, column.accessor, column.position), after)
            for index in members:
                _point_at(edit.tree["accessors"][index], view)
        for index in members:
            _update_bounds(edit.tree["accessors"][index], before, after)


def changing_buffers(edit: Edit, index: int, position: int) -> set[int]:
    """Return the buffers of the file that may change when all numbers of an accessor are new."""
    accessor, buffers = edit.accessors[index], edit.accessors.buffers
    layouts = [accessor.layout, accessor.sparse.values if accessor.sparse else None]
    read = {layout.buffer for layout in layouts if layout}
    stored = {index for index in read if buffers.source(index) != "decoded"}
    for view in edit.accessors.views:
        if view.buffer in read and view.packed is not None and view.fallback is not None:
            stored |= {view.packed.buffer, view.fallback[0]}
    found = {buffers.canonical(index) for index in stored if buffers.source(index) != "nowhere"}
    return found or {_buffer_for(edit, index, position)}


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
        view = edit.append_attribute(_buffer_for(edit, column.accessor, column.position), after)
        _point_at(edit.tree["accessors"][column.accessor], view, keep_sparse=True)


def _elements(edit: Edit, layout: Layout) -> Uint8s:
    return element_bytes(edit.open(edit.accessors.buffers.canonical(layout.buffer)), layout)


def _buffer_for(edit: Edit, index: int, position: int) -> int:
    """Return the buffer that takes new numbers: that of the old ones, of the positions, or any with bytes."""
    accessor, sparse = edit.accessors[index], edit.accessors[index].sparse
    layouts = [accessor.layout, sparse.values if sparse else None, edit.accessors[position].layout]
    return edit.growing_buffer(layout.buffer for layout in layouts if layout)


def _detach(edit: Edit, column: Column, before: Stored, after: Stored) -> None:
    """Store the numbers of a column outside of the data that Draco has compressed."""
    meshes, places = edit.container.root.entries("meshes"), set(column.users)
    users = [meshes[mesh].entries("primitives")[part] for mesh, part in column.users]
    for user in users:
        _require_same_order(edit, user, column.attribute)
    packed = users[0].entry("extensions").entry(DRACO)
    source = edit.accessors.views[packed.integer("bufferView")].buffer
    view = edit.append_attribute(edit.growing_buffer([source]), after)
    named = {user.entry("attributes").integer(column.attribute) for user in users}
    others = used_otherwise(edit.container.tree, column.attribute)
    for place, primitive in primitives_of(edit.container.tree):
        attributes = primitive.get("attributes", {})
        if place not in places and column.attribute in attributes:
            others.add(attributes[column.attribute])
    own = _own_accessors(edit, column.attribute, named, others, places)
    for mesh, part in places:
        extensions = edit.tree["meshes"][mesh]["primitives"][part]["extensions"]
        del extensions[DRACO]["attributes"][column.attribute]
    for index in own.values():
        _point_at(edit.tree["accessors"][index], view)
        _update_bounds(edit.tree["accessors"][index], before, after)


def _require_same_order(edit: Edit, primitive: Entry, attribute: str) -> None:
    """Raise an InputError if viewers that do not decode Draco would give the numbers to other vertices."""
    accessors, index = edit.accessors, primitive.integer("indices")
    packed = draco_extension(primitive)
    if packed is None or accessors[primitive.entry("attributes").integer(attribute)].layout is None:
        return
    plain, decoded = accessors.stored(index), accessors.stored(accessors.decoded_indices(packed, index))
    if not np.array_equal(plain, decoded):
        cause = "holds vertices in another order than its uncompressed fallback"
        raise packed.fault("bufferView", cause, "remove one of the two, and smooth the other")


def _own_accessors(
    edit: Edit,
    attribute: str,
    named: Collection[int],
    shared: Collection[int],
    users: Collection[tuple[int, int]] | None = None,
) -> dict[int, int]:
    """Return for each accessor itself or, if it is shared, a copy, which users (None: all primitives) then name."""
    own = {index: index for index in named}
    for index in sorted(named):
        if index in shared:
            own[index] = len(edit.tree["accessors"])
            old = edit.tree["accessors"][index].items()
            # Lists are copied, since bounds may be changed.
            edit.tree["accessors"].append({k: list(v) if isinstance(v, list) else v for k, v in old})
    for place, primitive in primitives_of(edit.tree):
        attributes = primitive.get("attributes", {})
        if attributes.get(attribute) in own and (users is None or place in users):
            attributes[attribute] = own[attributes[attribute]]
    return own


def _point_at(accessor: Tree, view: int, *, keep_sparse: bool = False) -> None:
    """Let an accessor take its elements from the start of a view: all, or all but sparse ones."""
    if not keep_sparse:
        accessor.pop("sparse", None)
    accessor["bufferView"] = view
    if "byteOffset" in accessor:
        accessor["byteOffset"] = 0


def _update_bounds(accessor: Tree, before: Stored, after: Stored) -> None:
    for key, reduce in (("min", np.min), ("max", np.max)):
        bounds: Any = accessor.get(key)
        if isinstance(bounds, list) and len(bounds) == after.shape[1]:
            was, now = reduce(before, axis=0), reduce(after, axis=0)
            for component in np.nonzero(was != now)[0]:
                bounds[component] = now[component].item()


def used_otherwise(tree: Tree, attribute: str) -> set[int]:
    """Return the accessors that are named as anything but a certain attribute of a primitive."""
    found: list[object] = []
    for _, primitive in primitives_of(tree):
        found += [index for key, index in primitive.get("attributes", {}).items() if key != attribute]
        found += [index for target in objects(primitive.get("targets")) for index in target.values()]
        found.append(primitive.get("indices"))
    for animation in objects(tree.get("animations")):
        for sampler in objects(animation.get("samplers")):
            found += [sampler.get("input"), sampler.get("output")]
    found += [skin.get("inverseBindMatrices") for skin in objects(tree.get("skins"))]
    for holder in objects([node.get("extensions") for node in objects(tree.get("nodes"))]):
        for extension in objects(list(holder.values())):
            attributes = extension.get("attributes", {})
            found += list(attributes.values()) if isinstance(attributes, dict) else []
    return {index for index in found if isinstance(index, int)}


def _alone(tree: Tree, accessors: Accessors, columns: Sequence[Column]) -> list[bool]:
    """Return for every column of one attribute whether nothing else uses its bytes and its accessors."""
    # The uses of every byte are counted, once for each column and for everything else that lies there: other
    # accessors element by element (so that interleaving is no conflict), sparse parts, and whole views that
    # serve images, extensions, or nothing that we know.
    otherwise = used_otherwise(tree, columns[0].attribute)
    # Plain elements, and sparse ones that replace some of them.
    found = [accessors[column.accessor] for column in columns]
    parts = [[each.layout, each.sparse.values if each.sparse else None] for each in found]
    own = [[_canonical(accessors, part) for part in both if part is not None] for both in parts]
    members = {member for column in columns for member in column.members}
    others = [_canonical(accessors, layout) for layout in _others(tree, accessors, members)]
    ranges = [(layout.buffer, layout.start, layout.end) for layouts in own for layout in layouts]
    buffer, start, end = np.array(ranges, np.int64).reshape(-1, 3).T
    counts = {each: np.zeros(_extent(accessors, each), np.uint8) for each, _, _ in ranges}
    for layout in [*(layout for layouts in own for layout in layouts), *others]:
        if ((buffer == layout.buffer) & (start < layout.end) & (layout.start < end)).any():
            uses = element_bytes(counts[layout.buffer], layout)
            uses[...] = np.minimum(uses + 1, 2)
    return [
        bool(layouts)
        and not column.members & otherwise
        and all((element_bytes(counts[layout.buffer], layout) == 1).all() for layout in layouts)
        for column, layouts in zip(columns, own, strict=True)
    ]


def _others(tree: Tree, accessors: Accessors, members: set[int]) -> Iterator[Layout]:
    """Give the bytes of everything that is not the elements of the columns."""
    viewed = set()
    for index, accessor in enumerate(accessors.all):
        viewed.add(accessor.view)
        if accessor.layout is not None and index not in members:
            yield accessor.layout
        if accessor.sparse is not None:
            viewed |= {accessor.entry.value["sparse"][part]["bufferView"] for part in ("indices", "values")}
            yield accessor.sparse.indices
            if index not in members:
                yield accessor.sparse.values
    named = set(named_views({key: value for key, value in tree.items() if key != "accessors"}))
    for index, view in enumerate(accessors.views):
        if index in named or index not in viewed:
            yield _whole(view)
    for (index, extension), view in named_places(tree, accessors.buffers.lengths):
        if extension is not None or accessors.views[index].packed is not None:
            yield _whole(view)


def _whole(view: View) -> Layout:
    return Layout(view.buffer, view.offset, view.length, view.length, 1)


def _canonical(accessors: Accessors, layout: Layout) -> Layout:
    return replace(layout, buffer=accessors.buffers.canonical(layout.buffer))


def _extent(accessors: Accessors, buffer: int) -> int:
    """Return a length that no view of this buffer, or of another over the same file, goes beyond."""
    buffers = accessors.buffers
    if buffers.source(buffer) == "decoded":
        return buffers.length(buffer)
    return max(buffers.lengths[index] for index in range(len(buffers)) if buffers.canonical(index) == buffer)
