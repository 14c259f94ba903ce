"""What changes in a glTF file, while the changes are collected: numbers, and images in place of others.

Compressed views are compressed again at the end. New images go over the old ones, to the end of the buffer, into a data
URI, or into a file.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import Accessors, Stored, padded_elements
from beltrami_cli.formats.gltf.buffers import data_uri, named_places, named_views
from beltrami_cli.formats.gltf.compression import repacked
from beltrami_cli.formats.gltf.container import Container
from beltrami_cli.formats.gltf.json_tree import Tree
from beltrami_cli.formats.gltf.textures import MEDIA, Images
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
        if len(octets) <= packed.length and _unshared(edit, own, home, packed.offset, end):
            edit.open(home)[packed.offset : end] = octets.ljust(packed.length, b"\0")
        else:
            extension |= {"buffer": home, "byteOffset": edit.append(home, octets)}
        plain, start = buffers.canonical(view.fallback[0]), view.fallback[1]
        end = start + len(data)
        if buffers.source(plain) != "nowhere" and _unshared(edit, (index, None), plain, start, end):
            edit.open(plain)[start:end] = data


def _unshared(edit: Edit, own: tuple[int, str | None], buffer: int, start: int, end: int) -> bool:
    """Return whether no other view, and no other extension of a view, names any of these bytes."""
    canonical = edit.accessors.buffers.canonical
    return not any(
        place != own and canonical(part.buffer) == buffer and part.offset < end and start < part.end
        for place, part in named_places(edit.container.tree, edit.accessors.buffers.lengths)
    )


_PADDING = 8  # bytes that may lie between views only to align them


@dataclass(frozen=True)
class _Blob:
    """An image for a buffer."""

    data: bytes
    view: int | None  # which it may overwrite; None: it needs its own
    images: tuple[int, ...]  # that show it


class ImageStorage:
    """New images while they are collected; `finish` puts images in buffers into place together."""

    def __init__(self, edit: Edit, images: Images) -> None:
        self._edit, self._images = edit, images
        self._named = Counter(named_views(edit.tree))
        self.blobs: dict[int, list[_Blob]] = defaultdict(list)  # by the buffer that `finish` puts them into

    def replace(self, image: int, file: ImageFile) -> int:
        """Give an image and its duplicates other bytes; return its index."""
        group = self._images.same(image)
        view = self._edit.tree["images"][image].get("bufferView")
        alone = view is not None and self._named[view] == len(group)
        is_plain = alone and "extensions" not in self._edit.tree["bufferViews"][view]
        self._put(group, file, view if is_plain else None)
        return image

    def add(self, image: int, file: ImageFile) -> int:
        """Add an image that is stored as another one is; return its index."""
        images = self._edit.tree["images"]
        images.append(dict(images[image]))
        self._put((len(images) - 1,), file, None)
        return len(images) - 1

    def _put(self, group: tuple[int, ...], file: ImageFile, view: int | None) -> None:
        media = MEDIA[file.suffix.lower()]
        for index in group:
            image = self._edit.tree["images"][index]
            if "bufferView" in image or "mimeType" in image:
                image["mimeType"] = media
        image = self._edit.tree["images"][group[0]]
        if "bufferView" in image:
            home = self._edit.tree["bufferViews"][image["bufferView"]]["buffer"]
            buffer = self._edit.accessors.buffers.canonical(home)
            self.blobs[buffer].append(_Blob(file.data, view, group))
        elif image["uri"][:5].lower() == "data:":
            same = image["uri"][5:].partition(",")[0].partition(";")[0].lower() == media
            image["uri"] = data_uri(image["uri"] if same else f"data:{media};base64,", file.data)
        else:
            self._edit.images |= dict.fromkeys(group, file)

    def finish(self) -> None:
        for buffer, blobs in self.blobs.items():
            _store(self._edit, buffer, blobs)


def _store(edit: Edit, buffer: int, blobs: Sequence[_Blob]) -> None:
    """Put images into one buffer: first where the old ones were as far as they fit, the others at the end."""
    views, data = edit.tree["bufferViews"], edit.open(buffer)
    # A view that only an image uses may be overwritten, if no other view shares its bytes.
    own = {
        blob.view: blob
        for blob in blobs
        if blob.view is not None and _unshared(edit, (blob.view, None), buffer, *_span(views[blob.view]))
    }
    others = [span for view, span in _spans(edit, buffer) if view not in own]
    end = _end(data, edit.tree["buffers"][buffer]["byteLength"], [_span(views[v]) for v in own], others)
    moving = [replace(blob, view=None) for blob in blobs if blob.view not in own]
    for view, blob in sorted(own.items(), key=lambda item: _span(views[item[0]])[0]):
        if _span(views[view])[0] >= end or not _fitted(edit, buffer, view, blob.data, end):
            moving.append(blob)
    del data[end:]
    edit.tree["buffers"][buffer]["byteLength"] = len(data)
    for blob in moving:
        start = edit.append(buffer, blob.data)
        place = {"buffer": buffer, "byteOffset": start, "byteLength": len(blob.data)}
        if blob.view is None:
            index = edit.add_view(place)
            for image in blob.images:
                edit.tree["images"][image]["bufferView"] = index
        else:
            views[blob.view] |= place


def _span(view: Tree) -> tuple[int, int]:
    start = view.get("byteOffset", 0)
    return start, start + view["byteLength"]


def _spans(edit: Edit, buffer: int) -> list[tuple[int | None, tuple[int, int]]]:
    """Return which bytes of a buffer are in use, each range with its view if it is one's."""
    canonical, tree = edit.accessors.buffers.canonical, edit.tree
    known = len(edit.accessors.buffers)
    same = {index for index in range(known) if canonical(index) == buffer} | {buffer}
    spans: list[tuple[int | None, tuple[int, int]]] = []
    lengths = [entry["byteLength"] for entry in tree["buffers"]]
    for (index, extension), part in named_places(tree, lengths):
        if part.buffer in same:
            spans.append((None if extension else index, (part.offset, part.end)))
    # Another buffer over the same file keeps its length, and so all of its bytes.
    return spans + [(None, (0, lengths[index])) for index in same - {buffer}]


def _end(
    data: bytearray, length: int, own: Sequence[tuple[int, int]], others: Sequence[tuple[int, int]]
) -> int:
    """Return where the bytes that must stay end: before the images to be replaced that are last in the buffer."""
    kept = max((end for _, end in others), default=0)
    if len(data) - length >= 4:  # more than the padding of a chunk: it may mean something
        return len(data)
    found, edge = len(data), length
    for start, end in sorted(own, reverse=True):
        if start < kept or not edge - _PADDING < end <= edge:
            break
        found = edge = start
    return found


def _fitted(edit: Edit, buffer: int, number: int, new: bytes, limit: int) -> bool:
    """Overwrite the old image if the new one fits before what comes next; leave zeros where it is not."""
    view, data = edit.tree["bufferViews"][number], edit.open(buffer)
    start, end = _span(view)
    after = min([limit, *(a for _, (a, _) in _spans(edit, buffer) if a >= end)])
    vacant = data.count(0, end, after) == after - end  # left by an earlier image, or padding
    fits = start + len(new) <= (after if vacant else end)
    data[start:end] = bytes(end - start)
    if fits:
        data[start : start + len(new)] = new
        view["byteLength"] = len(new)
    return fits
