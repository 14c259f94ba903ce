"""Whether stored numbers may be overwritten where they are: what else uses their bytes, or their accessors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.accessors import Layout, element_bytes
from beltrami_cli.formats.gltf.entries import objects, primitives_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.json_text import Tree


@dataclass(frozen=True)
class Column:
    """Numbers of one vertex attribute that painted primitives share."""

    attribute: str  # "COLOR_0", "POSITION" or "NORMAL"
    accessor: int  # where they are read
    members: frozenset[int]  # all accessors over these numbers that primitives name as this attribute
    users: tuple[tuple[int, int], ...]  # painted primitives that do: mesh, and index in the mesh
    position: int  # accessor of the positions that they belong to


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


def alone(tree: Tree, accessors: Accessors, columns: Sequence[Column]) -> list[bool]:
    """Return for every column of one attribute whether nothing else uses its bytes and its accessors."""
    # The uses of every byte are counted, once for each column and for everything else that lies there: other
    # accessors element by element (so that interleaving is no conflict), sparse parts, and whole views that
    # serve images, extensions, or nothing that we know.
    otherwise = used_otherwise(tree, columns[0].attribute)
    own = [_elements(accessors, column) for column in columns]
    members = set().union(*(column.members for column in columns))
    others = [_canonical(accessors, layout) for layout in _others(tree, accessors, members)]
    ranges = [(layout.buffer, layout.start, layout.end) for layouts in own for layout in layouts]
    places = np.array(ranges, np.int64).reshape(-1, 3)
    counts = {buffer: np.zeros(_extent(accessors, buffer), np.uint8) for buffer, _, _ in ranges}
    for layout in [*(layout for layouts in own for layout in layouts), *others]:
        if _meets(layout, places):
            uses = element_bytes(counts[layout.buffer], layout)
            uses[...] = np.minimum(uses + 1, 2)
    return [
        bool(layouts)
        and not column.members & otherwise
        and all((element_bytes(counts[layout.buffer], layout) == 1).all() for layout in layouts)
        for column, layouts in zip(columns, own, strict=True)
    ]


def _elements(accessors: Accessors, column: Column) -> list[Layout]:
    """Return where the numbers of a column are: plain elements, and those that replace some of them."""
    accessor = accessors[column.accessor]
    layouts = [accessor.layout, accessor.sparse.values if accessor.sparse else None]
    return [_canonical(accessors, layout) for layout in layouts if layout is not None]


def _others(tree: Tree, accessors: Accessors, members: set[int]) -> Iterator[Layout]:
    """Give the bytes of everything that is not the elements of the columns."""
    viewed = set()
    for index, accessor in enumerate(accessors.all):
        viewed.add(accessor.view)
        if accessor.layout is not None and index not in members:
            yield accessor.layout
        if accessor.sparse is not None:
            viewed |= _views_of_sparse(accessor.entry.value)
            yield accessor.sparse.indices
            if index not in members:
                yield accessor.sparse.values
    named = set(named_views({key: value for key, value in tree.items() if key != "accessors"}))
    for index, view in enumerate(accessors.views):
        if index in named or index not in viewed:
            yield Layout(view.buffer, view.offset, view.length, view.length, 1)
    for (index, extension), layout in named_places(tree, accessors.buffers.lengths):
        if extension is not None or accessors.views[index].packed is not None:
            yield layout


def named_places(tree: Tree, lengths: Sequence[int]) -> Iterator[tuple[tuple[int, str | None], Layout]]:
    """Give the bytes that views and their extensions name, as one element, with the view's index and extension."""
    for index, view in enumerate(objects(tree.get("bufferViews"))):
        for name, holder in [(None, view), *view.get("extensions", {}).items()]:
            if not isinstance(holder, dict):
                continue
            buffer, offset, length = (holder.get(key, 0) for key in ("buffer", "byteOffset", "byteLength"))
            if isinstance(buffer, int) and isinstance(offset, int) and isinstance(length, int):
                inside = 0 <= buffer < len(lengths) and offset >= 0 and length > 0
                if "buffer" in holder and inside and offset + length <= lengths[buffer]:
                    yield (index, name), Layout(buffer, offset, length, length, 1)


def _views_of_sparse(accessor: Tree) -> set[int]:
    return {accessor["sparse"][part]["bufferView"] for part in ("indices", "values")}


def named_views(value: object) -> Iterator[int]:
    """Give every member called "bufferView", in images and in extensions that we do not know."""
    if isinstance(value, dict):
        index = value.get("bufferView")
        if isinstance(index, int):
            yield index
        for child in value.values():
            yield from named_views(child)
    elif isinstance(value, list):
        for child in value:
            yield from named_views(child)


def _canonical(accessors: Accessors, layout: Layout) -> Layout:
    return replace(layout, buffer=accessors.buffers.canonical(layout.buffer))


def _extent(accessors: Accessors, buffer: int) -> int:
    """Return a length that no view of this buffer, or of another over the same file, goes beyond."""
    buffers = accessors.buffers
    if buffers.source(buffer) == "decoded":
        return buffers.length(buffer)
    return max(buffers.lengths[index] for index in range(len(buffers)) if buffers.canonical(index) == buffer)


def _meets(layout: Layout, ranges: NDArray[np.int64]) -> bool:
    buffer, start, end = ranges.T
    return bool(((buffer == layout.buffer) & (start < layout.end) & (layout.start < end)).any())
