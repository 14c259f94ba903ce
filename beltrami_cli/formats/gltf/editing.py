"""What changes in a glTF file, while the changes are collected."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.files import re_embedded
from beltrami_cli.formats.gltf.sharing import named_views

if TYPE_CHECKING:
    from collections.abc import Iterable

    from beltrami_cli.formats.gltf.accessors import Accessors, Stored
    from beltrami_cli.formats.gltf.container import Container
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.surface.records import ImageFile

VERTEX_DATA = 34962
"""What a view is for (ARRAY_BUFFER)."""


@dataclass
class Edit:
    """What changes in a file.

    Attributes
    ----------
    container : Container
        The file.
    accessors : Accessors
        Its accessors and buffers, as they were.
    tree : dict
        The JSON with all changes but the URIs of buffers, which depend on where they are written.
    buffers : dict of int to bytearray
        New bytes of the buffers that change, longer than before if something was appended.
    pictures : dict of int to ImageFile
        New content of images that are files of their own, by their index in the new JSON.
    notices : list of str
        What the user should be told.
    """

    container: Container
    accessors: Accessors
    tree: Tree
    buffers: dict[int, bytearray] = field(default_factory=dict)
    pictures: dict[int, ImageFile] = field(default_factory=dict)
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
        size = numbers.dtype.itemsize * numbers.shape[1]
        stride = -(-size // 4) * 4  # vertex attributes start at multiples of four bytes
        octets = np.zeros((len(numbers), stride), np.uint8)
        octets[:, :size] = np.ascontiguousarray(numbers).view(np.uint8)
        start = self.append(buffer, octets.tobytes())
        view = {"buffer": buffer, "byteOffset": start, "byteLength": octets.size, "target": VERTEX_DATA}
        return self.add_view(view | ({"byteStride": stride} if stride != size else {}))

    def add_view(self, view: Tree) -> int:
        """Add a view; return its index.

        Raises
        ------
        InputError
            If something in the file names a view of that index already, which was not there: it would mean this one.
        """
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

    def home(self, preferred: Iterable[int]) -> int:
        """Return the first of some buffers that takes bytes, otherwise any that does, otherwise a new one."""
        buffers = self.accessors.buffers
        for index in [*preferred, *range(len(buffers))]:
            if buffers.source(index) not in ("nowhere", "decoded"):
                return buffers.canonical(index)
        index = len(buffers)
        entries = self.tree.setdefault("buffers", [])
        if len(entries) == index:
            entries.append({"byteLength": 0, "uri": re_embedded("data:application/octet-stream,", b"")})
            self.buffers[index] = bytearray()
        return index


def copied(accessor: Tree) -> Tree:
    """Return a copy of an accessor whose bounds may be changed."""
    return {key: list(value) if isinstance(value, list) else value for key, value in accessor.items()}


def point_at(accessor: Tree, view: int, *, keep_sparse: bool = False) -> None:
    """Let an accessor take its elements from the start of a view: all, or all but sparse ones."""
    if not keep_sparse:
        accessor.pop("sparse", None)
    accessor["bufferView"] = view
    if "byteOffset" in accessor:
        accessor["byteOffset"] = 0


def update_bounds(accessor: Tree, before: Stored, after: Stored) -> None:
    """Renew those components of min and max, if they are there, whose true value changes."""
    for key, reduce in (("min", np.min), ("max", np.max)):
        bounds: Any = accessor.get(key)
        if isinstance(bounds, list) and len(bounds) == after.shape[1]:
            was, now = reduce(before, axis=0), reduce(after, axis=0)
            for component in np.nonzero(was != now)[0]:
                bounds[component] = now[component].item()
