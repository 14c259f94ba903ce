"""What changes in a glTF file, while the changes are collected; compressed views are compressed again at the end."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import padded_elements
from beltrami_cli.formats.gltf.buffers import named_places, named_views
from beltrami_cli.formats.gltf.compression import repacked
from beltrami_cli.formats.gltf.uris import data_uri

if TYPE_CHECKING:
    from collections.abc import Iterable

    from beltrami_cli.formats.gltf.accessors import Accessors, Stored
    from beltrami_cli.formats.gltf.buffers import View
    from beltrami_cli.formats.gltf.container import Container
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.surface.records import ImageFile

VERTEX_DATA, INDEX_DATA = 34962, 34963
"""What a view is for (ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER)."""


@dataclass
class Edit:
    """What changes in a file."""

    container: Container  # the file
    accessors: Accessors  # its accessors and buffers, as they were
    tree: Tree  # the JSON with all changes but the URIs of buffers, which depend on where they are written
    buffers: dict[int, bytearray] = field(default_factory=dict)  # new bytes of those that change, or grow
    images: dict[int, ImageFile] = field(
        default_factory=dict
    )  # new content of images that are files of their own
    notices: list[str] = field(default_factory=list)

    def open(self, index: int) -> bytearray:
        """Return the bytes of a buffer, to be changed."""
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
            raise InputError(
                self.container.name,
                f"it names bufferViews[{len(views)}], which is not there, so no view can be added",
                "repair the file",
            )
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


def compress_again(edit: Edit) -> None:
    """Put the changed bytes of all compressed views back into the buffers of the file."""
    for index, view in enumerate(edit.accessors.views):
        data = edit.buffers.pop(view.buffer, None) if view.packed is not None else None
        if data is not None:
            _compress(edit, index, view, data)


def _compress(edit: Edit, index: int, view: View, data: bytearray) -> None:
    """Put new data over the old if it fits and nothing else reads that, else append it; renew uncompressed bytes."""
    packed = view.packed
    if packed is None or view.fallback is None:
        raise AssertionError("only compressed views are compressed again")
    buffers = edit.accessors.buffers
    home, end = buffers.canonical(packed.buffer), packed.offset + packed.length
    octets = repacked(packed, data, buffers.stored(packed.buffer))
    extension = edit.tree["bufferViews"][index]["extensions"][packed.extension]
    extension.pop("filter", None)
    extension["byteLength"] = len(octets)
    if len(octets) <= packed.length and _unshared(edit, (index, packed.extension), home, packed.offset, end):
        edit.open(home)[packed.offset : end] = octets.ljust(packed.length, b"\0")
    else:
        extension |= {"buffer": home, "byteOffset": edit.append(home, octets)}
    plain, start = buffers.canonical(view.fallback[0]), view.fallback[1]
    if buffers.source(plain) != "nowhere" and _unshared(edit, (index, None), plain, start, start + len(data)):
        edit.open(plain)[start : start + len(data)] = data


def _unshared(edit: Edit, own: tuple[int, str | None], buffer: int, start: int, end: int) -> bool:
    """Return whether no other view, and no other extension of a view, names any of these bytes."""
    canonical = edit.accessors.buffers.canonical
    return not any(
        place != own and canonical(part.buffer) == buffer and part.offset < end and start < part.end
        for place, part in named_places(edit.container.tree, edit.accessors.buffers.lengths)
    )
