"""The changes of a glTF file, collected until they are stored in its buffers.

An entry of the JSON that something else uses, too, is copied before it changes (`Edit.separate`), and only the places
that follow the change name the copy. New bytes take the place of the old ones if nothing else reads those, otherwise
free bytes or the end of the buffer (`Edit.put`); no other view ever moves. Views that meshoptimizer has compressed are
compressed again, which loses nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Set
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.buffers import View
from beltrami_cli.formats.gltf.container import Container
from beltrami_cli.formats.gltf.entries import Tree
from beltrami_cli.formats.gltf.meshopt import repacked
from beltrami_cli.formats.gltf.references import view_references, view_spans
from beltrami_cli.formats.gltf.uris import data_uri
from beltrami_cli.surface.records import ImageFile

Holder = tuple[int, str | None]  # a view, and the extension with its compressed bytes or None
# An object or array, its member that is an index, and the change that applies to it.
Use = tuple[Any, Any, Hashable]


@dataclass
class Edit:
    """The changes of a file, collected until `finish`."""

    container: Container  # the file
    accessors: Accessors  # its accessors and buffers before the changes
    tree: Tree = field(init=False)  # the JSON with all changes but the URIs of buffers, which `output` adds
    buffers: dict[int, bytearray] = field(default_factory=dict)  # new bytes of buffers that change or grow
    images: dict[int, ImageFile] = field(default_factory=dict)  # new images in separate files
    notices: list[str] = field(default_factory=list)
    # New bytes that `finish` stores, by buffer and holder.
    _new: dict[int, dict[Holder, Bytes]] = field(default_factory=lambda: defaultdict(dict))

    def __post_init__(self) -> None:
        self.tree = self.container.copy_of_tree()

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
        return set(view_references(self.container.tree))

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
        return [each for each in view_spans(self.tree, lengths) if canonical(each[1].buffer) == buffer]

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
