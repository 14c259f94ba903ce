"""New values of vertex attributes in an edited glTF file.

Numbers of vertices are overwritten where they are if nothing else uses their bytes, and get a new view otherwise.
Attributes that Draco has compressed always get one, in the order in which decoders give the vertices: encoding a mesh
again would move its vertices and change their order. The compressed data stays as it is; the primitive just does not
name these numbers in it any more.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.formats.gltf.accessors import (
    Accessor,
    Accessors,
    Layout,
    Stored,
    element_bytes,
    padded_elements,
)
from beltrami_cli.formats.gltf.buffers import VERTEX_DATA, View
from beltrami_cli.formats.gltf.draco import DRACO
from beltrami_cli.formats.gltf.edit import Edit, Use
from beltrami_cli.formats.gltf.entries import Tree
from beltrami_cli.formats.gltf.primitives import Primitive
from beltrami_cli.formats.gltf.references import accessor_uses, view_references, view_spans


@dataclass(frozen=True)
class Column:
    """Values of a vertex attribute that coloured primitives share."""

    accessor: Accessor  # from which they are read
    members: Set[int]  # all accessors of these values that primitives use as this attribute
    users: Mapping[tuple[int, int], Primitive]  # coloured ones of these, by mesh and index in it
    position: Accessor  # of the same vertices
    before: Stored  # shape (rows, width)
    after: Stored


def exchange(edit: Edit, attribute: str, columns: Sequence[Column]) -> None:
    """Store the new values of all columns of an attribute."""
    changed = [n for n, each in enumerate(columns) if not np.array_equal(each.before, each.after)]
    if not changed:
        return
    uses = list(accessor_uses(edit.tree))
    shared = {holder[member] for place, holder, member in uses if place is None or member != attribute}
    is_alone = _alone(edit, columns, shared)
    # The column of each primitive, or of an accessor wherever it is used as this attribute.
    followed: dict[Hashable, int] = {}
    for number in changed:
        column = columns[number]
        if column.accessor.is_decoded:
            _detach(edit, attribute, column)
            followed |= dict.fromkeys(column.users, number)
        elif is_alone[number]:
            _overwrite(edit, column)
            for index in column.members:
                _update_bounds(edit.tree["accessors"][index], column)
        else:
            followed |= dict.fromkeys(column.members, number)
    changes: list[Use] = []
    for place, holder, member in uses:
        is_attribute = place is not None and member == attribute
        change = followed.get(place, followed.get(holder[member])) if is_attribute else None
        changes.append((holder, member, change))
    views: dict[int, int] = {}
    for (_, number), index in edit.separate("accessors", changes).items():
        if number not in views:
            views[number] = _put_numbers(edit, columns[number])
        _point_at(edit.tree["accessors"][index], views[number])
        _update_bounds(edit.tree["accessors"][index], columns[number])


def _overwrite(edit: Edit, column: Column) -> None:
    """Overwrite values in place; of a sparse accessor both the base elements and their replacements."""
    accessor, rows = column.accessor, column.accessor.replaced()
    is_element, octets = np.ones(len(column.after), bool), column.after.view(np.uint8)
    is_element[rows] = False
    if accessor.sparse is not None:
        _elements(edit, accessor.sparse.values)[...] = octets[rows]
    if accessor.layout is not None:
        _elements(edit, accessor.layout)[is_element] = octets[is_element]
    elif octets[is_element].any():  # elements without a view can only be zero
        view = _put_numbers(edit, column)
        for index in column.members:
            _point_at(edit.tree["accessors"][index], view, keep_sparse=True)


def _elements(edit: Edit, layout: Layout) -> Uint8s:
    return element_bytes(edit.open(edit.accessors.buffers.canonical(layout.buffer)), layout)


def _put_numbers(edit: Edit, column: Column) -> int:
    """Store new values in a new view, and return its index."""
    octets, size = padded_elements(column.after)
    stride = octets.shape[1]
    strided = {"byteStride": stride} if stride != size else {}
    view = edit.add("bufferViews", {"target": VERTEX_DATA, **strided})
    # Preferably in the buffer of the old values, or else of the positions.
    homes = [layout.buffer for layout in [*column.accessor.layouts, *column.position.layouts]]
    packed = [primitive.packed for primitive in column.users.values()]
    homes += [edit.accessors.views[each.integer("bufferView")].buffer for each in packed if each is not None]
    edit.put(edit.growing_buffer(homes), (view, None), octets.tobytes())
    return view


def _detach(edit: Edit, attribute: str, column: Column) -> None:
    """Remove a column from the attributes that the Draco data of coloured primitives provide."""
    for (mesh, part), primitive in column.users.items():
        _require_same_order(edit, primitive, attribute)
        extensions = edit.tree["meshes"][mesh]["primitives"][part]["extensions"]
        del extensions[DRACO]["attributes"][attribute]


def _require_same_order(edit: Edit, primitive: Primitive, attribute: str) -> None:
    """Raise InputError if viewers without Draco would assign the values to other vertices."""
    accessors, packed, decoded = edit.accessors, primitive.packed, primitive.indices
    plain = accessors[primitive.entry.integer("indices")]
    if packed is None or accessors[primitive.attributes.integer(attribute)].layout is None:
        return
    if decoded is None or not np.array_equal(plain.stored(), decoded.stored()):
        cause = "holds vertices in another order than its uncompressed fallback"
        raise packed.fault("bufferView", cause, "remove one of the two, and smooth the other")


def _point_at(accessor: Tree, view: int, *, keep_sparse: bool = False) -> None:
    """Make an accessor read its elements from the start of a view: all, or all except sparse ones."""
    if not keep_sparse:
        accessor.pop("sparse", None)
    accessor["bufferView"] = view
    if "byteOffset" in accessor:
        accessor["byteOffset"] = 0


def _update_bounds(accessor: Tree, column: Column) -> None:
    for key, reduce in (("min", np.min), ("max", np.max)):
        bounds: Any = accessor.get(key)
        if isinstance(bounds, list) and len(bounds) == column.after.shape[1]:
            was, now = reduce(column.before, axis=0), reduce(column.after, axis=0)
            for component in np.nonzero(was != now)[0]:
                bounds[component] = now[component].item()


def _alone(edit: Edit, columns: Sequence[Column], shared: set[int]) -> list[bool]:
    """Return for each column of an attribute whether its bytes and accessors have no other users."""
    # The uses of every byte are counted, once for each column and for everything else that lies there: other
    # accessors element by element (so that interleaving is not a conflict), sparse parts, and whole views that
    # serve images, extensions, or nothing that we know.
    accessors = edit.accessors

    def canonical(layout: Layout) -> Layout:
        return replace(layout, buffer=accessors.buffers.canonical(layout.buffer))

    layouts_of = [[canonical(layout) for layout in column.accessor.layouts] for column in columns]
    members = {member for column in columns for member in column.members}
    other_layouts = [canonical(layout) for layout in _others(edit.container.tree, accessors, members)]
    ranges = [(layout.buffer, layout.start, layout.end) for layout in chain(*layouts_of)]
    buffer, start, end = np.array(ranges, np.int64).reshape(-1, 3).T
    used = [
        layout
        for layout in [*chain(*layouts_of), *other_layouts]
        if ((buffer == layout.buffer) & (start < layout.end) & (layout.start < end)).any()
    ]
    counts = {n: np.zeros(max(each.end for each in used if each.buffer == n), np.uint8) for n, *_ in ranges}
    for layout in used:
        uses = element_bytes(counts[layout.buffer], layout)
        uses[...] = np.minimum(uses + 1, 2)
    return [
        bool(layouts)
        and not column.members & shared
        and all((element_bytes(counts[layout.buffer], layout) == 1).all() for layout in layouts)
        for column, layouts in zip(columns, layouts_of, strict=True)
    ]


def _others(tree: Tree, accessors: Accessors, members: set[int]) -> Iterator[Layout]:
    """Yield the byte ranges of everything except the elements of the columns."""
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
    named = set(view_references({key: value for key, value in tree.items() if key != "accessors"}))
    for index, view in enumerate(accessors.views):
        if index in named or index not in viewed:
            yield _whole(view)
    for (index, extension), view in view_spans(tree, accessors.buffers.lengths):
        if extension is not None or accessors.views[index].packed is not None:
            yield _whole(view)


def _whole(view: View) -> Layout:
    return Layout(view.buffer, view.offset, view.length, view.length, 1)
