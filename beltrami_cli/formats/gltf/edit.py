"""What changes in a glTF file, while the changes are collected: numbers of vertices, and images in place of others.

Numbers are overwritten where they are if nothing else uses their bytes. Otherwise a new bufferView at the end of
the buffer takes them, and only their accessor is pointed at it; no other view ever moves.

Attributes that Draco has compressed always get a view of their own, in the order in which decoders give the vertices:
encoding a mesh again would move its vertices and change their order. The compressed data stays as it is; the primitive
just does not name these numbers in it any more. Views that meshoptimizer has compressed are compressed again, which
loses nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import (
    DRACO,
    Accessors,
    Layout,
    Stored,
    draco_extension,
    element_bytes,
    padded_elements,
)
from beltrami_cli.formats.gltf.buffers import View, data_uri, named_places, named_views, repacked
from beltrami_cli.formats.gltf.container import Container, Entry, Tree, objects, primitives_of
from beltrami_cli.surface.records import ImageFile

VERTEX_DATA, INDEX_DATA = 34962, 34963  # what a view is for (ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER)


@dataclass
class Edit:
    """What changes in a file."""

    container: Container  # the file
    accessors: Accessors  # its accessors and buffers, as they were
    tree: Tree  # the JSON with all changes but the URIs of buffers, which depend on where they are written
    buffers: dict[int, bytearray] = field(default_factory=dict)  # new bytes of buffers that change or grow
    images: dict[int, ImageFile] = field(default_factory=dict)  # new images that are files of their own
    notices: list[str] = field(default_factory=list)

    def open(self, index: int) -> bytearray:
        if index not in self.buffers:
            self.buffers[index] = bytearray(self.accessors.buffers.stored(index))
        return self.buffers[index]

    def append(self, buffer: int, octets: bytes) -> int:
        """Put bytes at the end of a buffer, from a multiple of four on; return where they start."""
        data = self.open(buffer)
        data += bytes(-len(data) % 4)
        start = len(data)
        data += octets
        self.tree["buffers"][buffer]["byteLength"] = len(data)
        return start

    def append_attribute(self, buffer: int, numbers: Stored) -> int:
        """Put vertex data, shape (n, width), into a new view at the end of a buffer; return the view's index."""
        octets, size = padded_elements(numbers)
        start = self.append(buffer, octets.tobytes())
        view = {"buffer": buffer, "byteOffset": start, "byteLength": octets.size, "target": VERTEX_DATA}
        stride = octets.shape[1]
        return self.add_view(view | ({"byteStride": stride} if stride != size else {}))

    def add_view(self, view: Tree) -> int:
        """Add a view; return its index, which nothing in the file may name yet: it would mean this view."""
        views = self.tree.setdefault("bufferViews", [])
        if len(views) in self._named:
            cause = f"it names bufferViews[{len(views)}], which is not there, so no view can be added"
            raise InputError(self.container.name, cause, "repair the file")
        views.append(view)
        return len(views) - 1

    @cached_property
    def _named(self) -> set[int]:
        return set(named_views(self.container.tree))

    def growing_buffer(self, preferred: Iterable[int]) -> int:
        """Return the first of some buffers that takes bytes, otherwise any that does, otherwise a new one."""
        buffers = self.accessors.buffers
        for index in [*preferred, *range(len(buffers))]:
            if buffers.source(index) not in ("nowhere", "decoded"):
                return buffers.canonical(index)
        index = len(buffers)
        entries = self.tree.setdefault("buffers", [])
        if len(entries) == index:
            entries.append({"byteLength": 0, "uri": data_uri("data:application/octet-stream,", b"")})
            self.buffers[index] = bytearray()
        return index


@dataclass(frozen=True)
class Column:
    """Numbers of one vertex attribute that painted primitives share."""

    accessor: int  # where they are read
    members: Set[int]  # all accessors over these numbers that primitives name as this attribute
    users: Collection[tuple[int, int]]  # painted primitives that do: mesh, and index in the mesh
    position: int  # accessor of the positions that they belong to
    before: Stored  # shape (rows, width)
    after: Stored


def exchange(edit: Edit, attribute: str, columns: Sequence[Column]) -> None:
    """Put the new numbers of all columns of an attribute into a file."""
    changing = [not np.array_equal(column.before, column.after) for column in columns]
    if not any(changing):
        return
    shared = used_otherwise(edit.container.tree, attribute)
    in_place = _alone(edit, columns, shared)
    for column, is_changing, is_alone in zip(columns, changing, in_place, strict=True):
        if not is_changing:
            continue
        if edit.accessors.is_added(column.accessor):
            _detach(edit, attribute, column, shared)
            continue
        members: Collection[int] = column.members
        if is_alone:
            _overwrite(edit, column)
        else:
            members = _own_accessors(edit, attribute, column.members, shared)
            view = edit.append_attribute(_buffer_for(edit, column.accessor, column.position), column.after)
            for index in members:
                _point_at(edit.tree["accessors"][index], view)
        for index in members:
            _update_bounds(edit.tree["accessors"][index], column)


def changing_buffers(edit: Edit, index: int, position: int) -> set[int]:
    """Return the buffers of the file that may change when all numbers of an accessor are new."""
    buffers = edit.accessors.buffers
    read = {layout.buffer for layout in _value_layouts(edit.accessors, index)}
    stored = {index for index in read if buffers.source(index) != "decoded"}
    for view in edit.accessors.views:
        if view.buffer in read and view.packed is not None and view.fallback is not None:
            stored |= {view.packed.buffer, view.fallback[0]}
    found = {buffers.canonical(index) for index in stored if buffers.source(index) != "nowhere"}
    return found or {_buffer_for(edit, index, position)}


def _overwrite(edit: Edit, column: Column) -> None:
    """Put numbers where they are; of a sparse accessor each where it is read, the elements that it replaces too."""
    accessor, rows = edit.accessors[column.accessor], edit.accessors.replaced(column.accessor)
    own, octets = np.ones(len(column.after), bool), column.after.view(np.uint8)
    own[rows] = False
    if accessor.sparse is not None:
        _elements(edit, accessor.sparse.values)[...] = octets[rows]
    if accessor.layout is not None:
        _elements(edit, accessor.layout)[own] = octets[own]
    elif octets[own].any():  # no more zeros
        view = edit.append_attribute(_buffer_for(edit, column.accessor, column.position), column.after)
        _point_at(edit.tree["accessors"][column.accessor], view, keep_sparse=True)


def _elements(edit: Edit, layout: Layout) -> Uint8s:
    return element_bytes(edit.open(edit.accessors.buffers.canonical(layout.buffer)), layout)


def _buffer_for(edit: Edit, index: int, position: int) -> int:
    """Return the buffer that takes new numbers: that of the old ones, of the positions, or any with bytes."""
    layouts = [*_value_layouts(edit.accessors, index), edit.accessors[position].layout]
    return edit.growing_buffer(layout.buffer for layout in layouts if layout is not None)


def _detach(edit: Edit, attribute: str, column: Column, shared: set[int]) -> None:
    """Store the numbers of a column outside of the data that Draco has compressed."""
    meshes, places = edit.container.root.entries("meshes"), set(column.users)
    users = [meshes[mesh].entries("primitives")[part] for mesh, part in column.users]
    for user in users:
        _require_same_order(edit, user, attribute)
    packed = users[0].entry("extensions").entry(DRACO)
    source = edit.accessors.views[packed.integer("bufferView")].buffer
    view = edit.append_attribute(edit.growing_buffer([source]), column.after)
    named = {user.entry("attributes").integer(attribute) for user in users}
    others = set(shared)
    for place, primitive in primitives_of(edit.container.tree):
        attributes = primitive.get("attributes", {})
        if place not in places and attribute in attributes:
            others.add(attributes[attribute])
    for mesh, part in places:
        extensions = edit.tree["meshes"][mesh]["primitives"][part]["extensions"]
        del extensions[DRACO]["attributes"][attribute]
    for index in _own_accessors(edit, attribute, named, others, places):
        _point_at(edit.tree["accessors"][index], view)
        _update_bounds(edit.tree["accessors"][index], column)


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
) -> Collection[int]:
    """Return accessors, or a copy of each shared one, which users (None: all primitives) name in its place."""
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
    return own.values()


def _point_at(accessor: Tree, view: int, *, keep_sparse: bool = False) -> None:
    """Let an accessor take its elements from the start of a view: all, or all but sparse ones."""
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


def _alone(edit: Edit, columns: Sequence[Column], shared: set[int]) -> list[bool]:
    """Return for every column of one attribute whether nothing else uses its bytes and its accessors."""
    # The uses of every byte are counted, once for each column and for everything else that lies there: other
    # accessors element by element (so that interleaving is no conflict), sparse parts, and whole views that
    # serve images, extensions, or nothing that we know.
    accessors = edit.accessors

    def canonical(layout: Layout) -> Layout:
        return replace(layout, buffer=accessors.buffers.canonical(layout.buffer))

    own = [[canonical(layout) for layout in _value_layouts(accessors, column.accessor)] for column in columns]
    members = {member for column in columns for member in column.members}
    others = [canonical(layout) for layout in _others(edit.container.tree, accessors, members)]
    ranges = [(layout.buffer, layout.start, layout.end) for layouts in own for layout in layouts]
    buffer, start, end = np.array(ranges, np.int64).reshape(-1, 3).T
    counts = {each: np.zeros(accessors.buffers.extent(each), np.uint8) for each, _, _ in ranges}
    for layout in [*(layout for layouts in own for layout in layouts), *others]:
        if ((buffer == layout.buffer) & (start < layout.end) & (layout.start < end)).any():
            uses = element_bytes(counts[layout.buffer], layout)
            uses[...] = np.minimum(uses + 1, 2)
    return [
        bool(layouts)
        and not column.members & shared
        and all((element_bytes(counts[layout.buffer], layout) == 1).all() for layout in layouts)
        for column, layouts in zip(columns, own, strict=True)
    ]


def _value_layouts(accessors: Accessors, index: int) -> list[Layout]:
    """Return where the numbers of an accessor lie: its elements, and sparse ones that replace some of them."""
    accessor = accessors[index]
    layouts = [accessor.layout, accessor.sparse.values if accessor.sparse else None]
    return [layout for layout in layouts if layout is not None]


def _others(tree: Tree, accessors: Accessors, members: set[int]) -> Iterator[Layout]:
    """Iterate over the bytes of everything but the elements of the columns."""
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


def compress_again(edit: Edit) -> None:
    """Put the changed bytes of all compressed views back into the buffers of the file."""
    # New data goes over the old if it fits and nothing else reads that, else to the end; plain bytes are renewed.
    buffers = edit.accessors.buffers
    for index, view in enumerate(edit.accessors.views):
        packed = view.packed
        if packed is None or view.fallback is None or view.buffer not in edit.buffers:
            continue
        data = edit.buffers.pop(view.buffer)
        home, end = buffers.canonical(packed.buffer), packed.offset + packed.length
        octets = repacked(packed, data, buffers.stored(packed.buffer))
        extension = edit.tree["bufferViews"][index]["extensions"][packed.extension]
        extension.pop("filter", None)
        extension["byteLength"] = len(octets)
        own = index, packed.extension
        if len(octets) <= packed.length and is_unshared(edit, own, home, packed.offset, end):
            edit.open(home)[packed.offset : end] = octets.ljust(packed.length, b"\0")
        else:
            extension |= {"buffer": home, "byteOffset": edit.append(home, octets)}
        plain, start = buffers.canonical(view.fallback[0]), view.fallback[1]
        end = start + len(data)
        if buffers.source(plain) != "nowhere" and is_unshared(edit, (index, None), plain, start, end):
            edit.open(plain)[start:end] = data


def is_unshared(edit: Edit, own: tuple[int, str | None], buffer: int, start: int, end: int) -> bool:
    """Whether no other view, and no other extension of a view, names any of these bytes."""
    canonical = edit.accessors.buffers.canonical
    return not any(
        place != own and canonical(part.buffer) == buffer and part.offset < end and start < part.end
        for place, part in named_places(edit.container.tree, edit.accessors.buffers.lengths)
    )
