"""Collect the changes of a glTF file: new vertex attributes and new images.

An entry of the JSON that something else uses, too, is copied before it changes (`Edit.separate`), and only the places
that follow the change name the copy. New bytes take the place of the old ones if nothing else reads those, otherwise
free bytes or the end of the buffer (`Edit.put`); no other view ever moves.

Numbers of vertices are overwritten where they are if nothing else uses their bytes, and get a new view otherwise.
Attributes that Draco has compressed always get one, in the order in which decoders give the vertices: encoding a mesh
again would move its vertices and change their order. The compressed data stays as it is; the primitive just does not
name these numbers in it any more. Views that meshoptimizer has compressed are compressed again, which loses nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence, Set
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.accessors import (
    DRACO,
    Accessor,
    Accessors,
    Layout,
    Primitive,
    Stored,
    element_bytes,
    padded_elements,
)
from beltrami_cli.formats.gltf.buffers import MESHOPT, View, data_uri, named_places, named_views, repacked
from beltrami_cli.formats.gltf.container import Container, Tree, objects, primitives_of
from beltrami_cli.surface.records import ImageFile

_ALIGNMENT = 8  # of merged buffers: enough for all component types, and required by KHR extensions
VERTEX_DATA, INDEX_DATA = 34962, 34963  # targets of views (ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER)
Holder = tuple[int, str | None]  # a view, and the extension with its compressed bytes or None
# An object or array, its member that is an index, and the change that applies to it.
Use = tuple[Any, Any, Hashable]


@dataclass
class Edit:
    """The changes of a file, collected until `finish`."""

    container: Container  # the file
    accessors: Accessors  # its accessors and buffers before the changes
    tree: Tree  # the JSON with all changes except the URIs of buffers, which depend on the output
    buffers: dict[int, bytearray] = field(default_factory=dict)  # new bytes of buffers that change or grow
    images: dict[int, ImageFile] = field(default_factory=dict)  # new images in separate files
    notices: list[str] = field(default_factory=list)
    # New bytes that `finish` stores, by buffer and holder.
    _new: dict[int, dict[Holder, Bytes]] = field(default_factory=lambda: defaultdict(dict))

    def source(self, index: int) -> str:
        """Return the location of a buffer's bytes, as `Buffers` does; added buffers are data URIs."""
        return self.accessors.buffers.source(index) if index < len(self.accessors.buffers) else "data"

    def open(self, index: int) -> bytearray:
        if index not in self.buffers:
            self.buffers[index] = bytearray(self.accessors.buffers.stored(index))
        return self.buffers[index]

    def separate(
        self, kind: str, uses: Iterable[Use], copied: Callable[[Tree], Tree] = deepcopy
    ) -> dict[tuple[int, Any], int]:
        """Give each change entries that nothing else uses; return their indices by old index and change.

        `uses` are all places that name entries, each with the change that it follows, None if it follows none.
        """
        entries: list[Tree] = self.tree[kind]
        places: dict[int, dict[Hashable, list[tuple[Any, Any]]]] = defaultdict(lambda: defaultdict(list))
        for holder, member, change in uses:
            places[holder[member]][change].append((holder, member))
        index_of = {}
        for old, by_change in places.items():
            is_shared = by_change.pop(None, None) is not None
            for change, members in by_change.items():
                index_of[old, change] = old
                if is_shared:
                    index_of[old, change] = self.add(kind, copied(entries[old]))
                    for holder, member in members:
                        holder[member] = index_of[old, change]
                is_shared = True
        return index_of

    def add(self, kind: str, entry: Tree) -> int:
        """Add an entry, and return its index; InputError if the file, wrongly, refers to that index already."""
        entries = self.tree.setdefault(kind, [])
        if kind == "bufferViews" and len(entries) in self._named_views:
            cause = f"it names bufferViews[{len(entries)}], which is not there, so no view can be added"
            raise InputError(self.container.name, cause, "repair the file")
        entries.append(entry)
        return len(entries) - 1

    @cached_property
    def _named_views(self) -> set[int]:
        return set(named_views(self.container.tree))

    def put(self, buffer: int, holder: Holder, octets: Bytes) -> None:
        """Record new bytes of a view or its extension, which `finish` stores in a buffer."""
        self._new[self.accessors.buffers.canonical(buffer)][holder] = octets

    def growing_buffer(self, preferred: Iterable[int]) -> int:
        """Return the first of some buffers that can be extended, or else any other, or else a new one."""
        count = len(self.accessors.buffers)
        for index in [*preferred, *range(count)]:
            if self.accessors.buffers.source(index) not in ("nowhere", "decoded"):
                return self.accessors.buffers.canonical(index)
        if len(self.tree.setdefault("buffers", [])) == count:
            self.add("buffers", {"byteLength": 0, "uri": data_uri("data:application/octet-stream,", b"")})
            self.buffers[count] = bytearray()
        return count

    def finish(self) -> None:
        """Store all new bytes in their buffers."""
        self._compress_again()
        for buffer, new in self._new.items():
            self._store(buffer, new)
        self._new.clear()

    def _compress_again(self) -> None:
        """Compress the changed bytes of views again, and update their uncompressed fallbacks."""
        buffers = self.accessors.buffers
        for index, view in enumerate(self.accessors.views):
            packed = view.packed
            if packed is None or view.fallback is None or view.buffer not in self.buffers:
                continue
            data = self.buffers.pop(view.buffer)
            self.tree["bufferViews"][index]["extensions"][packed.extension].pop("filter", None)
            octets = repacked(packed, data, buffers.stored(packed.buffer))
            self.put(packed.buffer, (index, packed.extension), octets)
            plain, start = buffers.canonical(view.fallback[0]), view.fallback[1]
            end = start + len(data)
            is_alone = all(
                holder == (index, None) or part.end <= start or end <= part.offset
                for holder, part in self._places(plain)
            )
            if is_alone and buffers.source(plain) != "nowhere":
                self.open(plain)[start:end] = data

    def _places(self, buffer: int) -> list[tuple[Holder, View]]:
        """Return the byte ranges of views and their extensions in a buffer and in others of the same file."""
        lengths = [entry["byteLength"] for entry in self.tree["buffers"]]
        canonical = self.accessors.buffers.canonical
        return [each for each in named_places(self.tree, lengths) if canonical(each[1].buffer) == buffer]

    def _store(self, buffer: int, new: dict[Holder, Bytes]) -> None:
        """Store new bytes in a buffer: in the space of old ones where they fit, otherwise at the end."""
        vacant, data = self._released_spans(buffer, new.keys()), self.open(buffer)
        for (view, extension), octets in new.items():
            size = len(octets)
            chosen = next((n for n, (start, end) in enumerate(vacant) if size <= end - start), None)
            if chosen is None:
                data += bytes(-len(data) % 4)
                start = len(data)
                data += octets
            else:
                start, end = vacant[chosen]
                data[start : start + size] = octets
                vacant[chosen] = start + size + -size % 4, end
            named = self.tree["bufferViews"][view]
            named = named if extension is None else named["extensions"][extension]
            named |= {"buffer": buffer, "byteOffset": start, "byteLength": size}
        self.tree["buffers"][buffer]["byteLength"] = len(data)

    def _released_spans(self, buffer: int, holders: Set[Holder]) -> list[tuple[int, int]]:
        """Clear the bytes that only these holders use, trim them at the end, and return the free spans."""
        places, data = self._places(buffer), self.open(buffer)
        left = [
            (part.offset, part.end)
            for holder, part in places
            if holder in holders
            and not any(
                other != holder and near.offset < part.end and part.offset < near.end
                for other, near in places
            )
        ]
        taken = [span for _, part in places if (span := (part.offset, part.end)) not in left]
        # Another buffer over the same file keeps its length, and so all of its bytes.
        taken += [
            (0, entry["byteLength"])
            for index, entry in enumerate(self.tree["buffers"])
            if index != buffer and self.accessors.buffers.canonical(index) == buffer
        ]
        for start, end in left:
            data[start:end] = bytes(end - start)
        last = max((end for _, end in taken), default=0)
        if left and data.count(0, last) == len(data) - last:
            del data[last:]
        return [(start, end) for start, end in _gaps(taken) if data.count(0, start, end) == end - start]


def _gaps(spans: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield the gaps between spans, aligned to four bytes."""
    at = 0
    for start, end in sorted(spans):
        if start > at:
            yield at, start
        at = max(at, end + -end % 4)


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


def accessor_uses(tree: Tree) -> Iterator[tuple[tuple[int, int] | None, Tree, str]]:
    """Yield the references to accessors, as (primitive if it is an attribute of one, holder, key)."""
    # Primitives, objects, and the members of these that refer to accessors; no members: all.
    holders: list[tuple[tuple[int, int] | None, Any, tuple[str, ...]]] = []
    for number, primitive in primitives_of(tree):
        holders += [(number, primitive.get("attributes"), ()), (None, primitive, ("indices",))]
        holders += [(None, target, ()) for target in objects(primitive.get("targets"))]
    for animation in objects(tree.get("animations")):
        holders += [(None, each, ("input", "output")) for each in objects(animation.get("samplers"))]
    holders += [(None, skin, ("inverseBindMatrices",)) for skin in objects(tree.get("skins"))]
    for extensions in objects([node.get("extensions") for node in objects(tree.get("nodes"))]):
        holders += [(None, each.get("attributes"), ()) for each in objects(list(extensions.values()))]
    for place, holder, keys in holders:
        if isinstance(holder, dict):
            yield from ((place, holder, key) for key in keys or holder if isinstance(holder.get(key), int))


def _alone(edit: Edit, columns: Sequence[Column], shared: set[int]) -> list[bool]:
    """Return for each column of an attribute whether its bytes and accessors have no other users."""
    # The uses of every byte are counted, once for each column and for everything else that lies there: other
    # accessors element by element (so that interleaving is not a conflict), sparse parts, and whole views that
    # serve images, extensions, or nothing that we know.
    accessors = edit.accessors

    def canonical(layout: Layout) -> Layout:
        return replace(layout, buffer=accessors.buffers.canonical(layout.buffer))

    own = [[canonical(layout) for layout in column.accessor.layouts] for column in columns]
    members = {member for column in columns for member in column.members}
    other_layouts = [canonical(layout) for layout in _others(edit.container.tree, accessors, members)]
    ranges = [(layout.buffer, layout.start, layout.end) for layout in chain(*own)]
    buffer, start, end = np.array(ranges, np.int64).reshape(-1, 3).T
    used = [
        layout
        for layout in [*chain(*own), *other_layouts]
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
        for column, layouts in zip(columns, own, strict=True)
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
    named = set(named_views({key: value for key, value in tree.items() if key != "accessors"}))
    for index, view in enumerate(accessors.views):
        if index in named or index not in viewed:
            yield _whole(view)
    for (index, extension), view in named_places(tree, accessors.buffers.lengths):
        if extension is not None or accessors.views[index].packed is not None:
            yield _whole(view)


def _whole(view: View) -> Layout:
    return Layout(view.buffer, view.offset, view.length, view.length, 1)


def merge_buffers(edit: Edit) -> bytearray:
    """Merge all buffers that have bytes, and make the views refer to the result."""
    tree, binary, starts = edit.tree, bytearray(), dict[int, int]()
    entries, canonical = tree.get("buffers", []), edit.accessors.buffers.canonical
    for index in range(len(entries)):
        if canonical(index) in starts:
            starts[index] = starts[canonical(index)]
        elif edit.source(index) != "nowhere":
            binary += bytes(-len(binary) % _ALIGNMENT)
            starts[index] = len(binary)
            binary += edit.buffers[index] if index in edit.buffers else edit.accessors.buffers.stored(index)
    if not starts:
        return binary
    kept = [index for index in range(len(entries)) if index not in starts]
    numbers = dict.fromkeys(starts, 0) | {index: 1 + rank for rank, index in enumerate(kept)}
    for view in tree.get("bufferViews", []):
        for holder in objects([view, *view.get("extensions", {}).values()]):
            if isinstance(holder.get("buffer"), int):
                start = starts.get(holder["buffer"], 0)
                holder["buffer"] = numbers.get(holder["buffer"], holder["buffer"])
                if start and isinstance(holder.get("byteOffset", 0), int):
                    holder["byteOffset"] = holder.get("byteOffset", 0) + start
    merged = {key: value for key, value in entries[next(iter(starts))].items() if key != "uri"}
    merged["byteLength"] = len(binary)
    if "extensions" in merged:  # then it is not only a fallback for compressed data
        others = {key: value for key, value in merged.pop("extensions").items() if key not in MESHOPT}
        merged |= {"extensions": others} if others else {}
    tree["buffers"] = [merged, *(entries[index] for index in kept)]
    return binary
