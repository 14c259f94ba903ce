"""New values of vertex attributes in an edited glTF file: colours, positions and normals.

Numbers of vertices are overwritten where they are if nothing else uses their bytes, and get a new view otherwise.
Attributes that Draco has compressed always get one, in the order in which decoders give the vertices: encoding a mesh
again would move its vertices and change their order. The compressed data stays as it is; the primitive just does not
name these numbers in it any more.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.formats.colours import quantised
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
from beltrami_cli.formats.gltf.references import accessor_uses, primitives_of, view_references, view_spans
from beltrami_cli.formats.gltf.vertex_colours import Block
from beltrami_cli.surface.geometry import unit_vectors
from beltrami_cli.surface.records import MovedVertices

_STALE_NOTICE = "The vertices moved, but their {} are as they were; make them again, or leave them out."


def recolour(edit: Edit, blocks: Sequence[Block], old: Float32s, new: Float32s) -> None:
    """Put new colours (V, 3) into a file; only entries that differ from the old ones change."""
    if new.shape != old.shape or not np.isfinite(new).all():
        raise ValueError(f"colours must be finite and of shape {old.shape}, not {new.shape}")

    def recoloured(block: Block, before: Stored) -> Stored:
        entries, after = new[block.rows] != old[block.rows], before.copy()
        after[:, :3][entries] = quantised(new[block.rows][entries], before.dtype)
        return after

    _exchange(edit, blocks, "COLOR_0", recoloured)


def put_dummies(edit: Edit, blocks: Sequence[Block], *, places: bool) -> None:
    """Put numbers unlike the present ones into a file: for colours, or for all that can move, too."""
    for attribute in ("COLOR_0", *(("POSITION", "NORMAL") if places else ())):
        _exchange(edit, blocks, attribute, lambda _, before: (~before.view(np.uint8)).view(before.dtype))


def require_movable(blocks: Sequence[Block]) -> None:
    """Check that positions can be replaced: floats, not compressed by Draco, and not scaled to nothing."""
    for block in blocks:
        accessor = block.accessors["POSITION"]
        if accessor.is_decoded:
            remedy = "decompress the model first with a glTF optimiser"
            raise accessor.entry.fault("", "Draco positions cannot be replaced", remedy)
        if accessor.component.kind != "f":
            kind = f"{accessor.component.name} (KHR_mesh_quantization)"
            cause = f"positions are {kind}, which cannot hold smoothed ones"
            raise accessor.entry.fault("componentType", cause, "store them as floats, with a glTF optimiser")
        if abs(np.linalg.det(block.placement.matrix[:3, :3])) < np.finfo(np.float64).tiny:
            raise accessor.entry.fault("", "its node scales the positions to nothing")


def move(edit: Edit, blocks: Sequence[Block], old: Float64s, places: MovedVertices) -> None:
    """Put new positions, and normals if there are any, into a file; only rows that change are written."""
    moves, normals = places.positions - old, places.normals

    def moved(block: Block, before: Stored) -> Stored:
        rows, after = moves[block.rows].any(axis=1), before.copy()
        local = moves[block.rows][rows] @ np.linalg.inv(block.placement.matrix[:3, :3]).T
        after[rows] = (before[rows].astype(np.float64) + local).astype(before.dtype)
        return after

    def turned(block: Block, before: Stored) -> Stored:
        assert normals is not None
        new, after = normals[block.rows], before.copy()
        rows = ~np.isnan(new).any(axis=1)
        # Normals went to the common space by the inverse transpose.
        local = unit_vectors(new[rows].astype(np.float64) @ block.placement.matrix[:3, :3])
        after[rows] = local if before.dtype.kind == "f" else np.rint(local * np.iinfo(before.dtype).max)
        return after

    _exchange(edit, blocks, "POSITION", moved)
    if normals is not None:
        _exchange(edit, blocks, "NORMAL", turned)
    has_normals = any("NORMAL" in block.accessors for block in blocks)
    users = [user for block in blocks for user in block.users.values()]
    has_tangents = any("TANGENT" in user for user in users)
    stale = {"normals": has_normals and normals is None, "tangents": has_tangents}
    edit.notices += [_STALE_NOTICE.format(what) for what, is_stale in stale.items() if is_stale]


@dataclass(frozen=True)
class _Column:
    """Values of a vertex attribute that coloured primitives share."""

    accessor: Accessor  # from which they are read
    members: Set[int]  # all accessors of these values that primitives use as this attribute
    users: Mapping[tuple[int, int], Primitive]  # coloured ones of these, by mesh and index in it
    position: Accessor  # of the same vertices
    before: Stored  # shape (rows, width)
    after: Stored


def _exchange(
    edit: Edit, blocks: Sequence[Block], attribute: str, renewed: Callable[[Block, Stored], Stored]
) -> None:
    """Exchange an attribute of all blocks, which may share its numbers; only new rows are written."""
    accessors = edit.accessors
    # By identity, the accessors that primitives name, coloured or not.
    members: dict[Hashable, set[int]] = defaultdict(set)
    for _, primitive in primitives_of(edit.container.tree):
        index = primitive.get("attributes", {}).get(attribute, -1)
        if 0 <= index < len(accessors):
            members[accessors[index].identity].add(index)
    columns: dict[Hashable, _Column] = {}
    for block in blocks:
        if attribute not in block.accessors:
            continue
        accessor, position = block.accessors[attribute], block.accessors["POSITION"]
        before, key = accessor.stored(), accessor.identity
        after = renewed(block, before)
        if key not in columns:
            columns[key] = _Column(accessor, members[key], block.users, position, before, after)
            continue
        earlier = columns[key].after
        changes, other = (after != before).any(axis=1), (earlier != before).any(axis=1)
        if attribute == "POSITION" and not np.array_equal(after[changes | other], earlier[changes | other]):
            cause = "is shared by parts that would move apart"
            raise accessor.entry.fault("", cause, "give each part positions of its own")
        earlier[changes] = after[changes]
    _store(edit, attribute, list(columns.values()))


def _store(edit: Edit, attribute: str, columns: Sequence[_Column]) -> None:
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


def _overwrite(edit: Edit, column: _Column) -> None:
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


def _put_numbers(edit: Edit, column: _Column) -> int:
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


def _detach(edit: Edit, attribute: str, column: _Column) -> None:
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


def _update_bounds(accessor: Tree, column: _Column) -> None:
    for key, reduce in (("min", np.min), ("max", np.max)):
        bounds: Any = accessor.get(key)
        if isinstance(bounds, list) and len(bounds) == column.after.shape[1]:
            was, now = reduce(column.before, axis=0), reduce(column.after, axis=0)
            for component in np.nonzero(was != now)[0]:
                bounds[component] = now[component].item()


def _alone(edit: Edit, columns: Sequence[_Column], shared: set[int]) -> list[bool]:
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
