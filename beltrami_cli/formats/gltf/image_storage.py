"""New images stored: over the old ones, at the end of the buffer, in a data URI, or in a file."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.buffers import named_places, named_views
from beltrami_cli.formats.gltf.uris import data_uri

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.formats.gltf.edit import Edit
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.textures import Images
    from beltrami_cli.surface.records import ImageFile

MEDIA = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".jpe": "image/jpeg",
    ".jfif": "image/jpeg",
    ".webp": "image/webp",
    ".ktx2": "image/ktx2",
    ".avif": "image/avif",
}
"""Media types of the images that glTF can hold, by suffix."""

_PADDING = 8  # bytes that may lie between views only to align them


@dataclass(frozen=True)
class _Blob:
    """An image for a buffer."""

    data: bytes
    buffer: int
    view: int | None  # which it may overwrite; None: it needs its own
    images: tuple[int, ...]  # that show it


class ImageStorage:
    """New images while they are collected; `finish` puts those of buffers into place together."""

    def __init__(self, edit: Edit, images: Images) -> None:
        self._edit, self._images = edit, images
        self._named = Counter(named_views(edit.tree))
        self._blobs: list[_Blob] = []

    def replace(self, image: int, file: ImageFile) -> int:
        """Give an image, and those that are the same, other bytes; return its index."""
        group = self._images.same(image)
        view = self._edit.tree["images"][image].get("bufferView")
        alone = view is not None and self._named[view] == len(group)
        self._put(group, file, view if alone and not self._extended(view) else None)
        return image

    def add(self, image: int, file: ImageFile) -> int:
        """Add an image that is stored as another one is; return its index."""
        images = self._edit.tree["images"]
        images.append(dict(images[image]))
        self._put((len(images) - 1,), file, None)
        return len(images) - 1

    def _extended(self, view: int) -> bool:
        return "extensions" in self._edit.tree["bufferViews"][view]

    def _put(self, group: tuple[int, ...], file: ImageFile, view: int | None) -> None:
        media = MEDIA[file.suffix.lower()]
        for index in group:
            image = self._edit.tree["images"][index]
            if "bufferView" in image or "mimeType" in image:
                image["mimeType"] = media
        image = self._edit.tree["images"][group[0]]
        if "bufferView" in image:
            home = self._edit.tree["bufferViews"][image["bufferView"]]["buffer"]
            home = self._edit.accessors.buffers.canonical(home)
            self._blobs.append(_Blob(file.data, home, view, group))
        elif image["uri"][:5].lower() == "data:":
            image["uri"] = _embedded(image["uri"], file.data, media)
        else:
            self._edit.images |= dict.fromkeys(group, file)

    def finish(self) -> None:
        """Put the bytes of images into their buffers."""
        by_buffer: dict[int, list[_Blob]] = defaultdict(list)
        for blob in self._blobs:
            by_buffer[blob.buffer].append(blob)
        for buffer, blobs in by_buffer.items():
            _store(self._edit, buffer, blobs)


def _embedded(uri: str, data: bytes, media: str) -> str:
    head = uri.partition(",")[0]
    same = head[5:].partition(";")[0].lower() == media
    return data_uri(uri if same else f"data:{media};base64,", data)


def _store(edit: Edit, buffer: int, blobs: Sequence[_Blob]) -> None:
    """Put images into one buffer: first where the old ones were as far as they fit, the others at the end."""
    views, data = edit.tree["bufferViews"], edit.open(buffer)
    blobs = _without_overlaps(edit, buffer, blobs)
    own = {blob.view for blob in blobs if blob.view is not None}
    others = [span for view, span in _spans(edit, buffer) if view not in own]
    end = _end(data, edit.tree["buffers"][buffer]["byteLength"], [_span(views[v]) for v in own], others)
    moving = []
    for blob in sorted(blobs, key=lambda blob: -1 if blob.view is None else _span(views[blob.view])[0]):
        if blob.view is None or _span(views[blob.view])[0] >= end or not _fitted(edit, buffer, blob, end):
            moving.append(blob)
    del data[end:]
    for blob in moving:
        data += bytes(-len(data) % 4)
        place = {"buffer": buffer, "byteOffset": len(data), "byteLength": len(blob.data)}
        if blob.view is None:
            index = edit.add_view(place)
            for image in blob.images:
                edit.tree["images"][image]["bufferView"] = index
        else:
            views[blob.view] |= place
        data += blob.data
    edit.tree["buffers"][buffer]["byteLength"] = len(data)


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


def _without_overlaps(edit: Edit, buffer: int, blobs: Sequence[_Blob]) -> list[_Blob]:
    """Return the images, without the views of those whose bytes belong to something else as well."""
    spans, views = _spans(edit, buffer), edit.tree["bufferViews"]
    found = []
    for blob in blobs:
        if blob.view is not None:
            start, end = _span(views[blob.view])
            if any(view != blob.view and a < end and start < b for view, (a, b) in spans):
                blob = replace(blob, view=None)
        found.append(blob)
    return found


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


def _fitted(edit: Edit, buffer: int, blob: _Blob, limit: int) -> bool:
    """Overwrite the old image if the new one fits before what comes next; leave zeros where it is not."""
    if blob.view is None:
        return False
    view, data = edit.tree["bufferViews"][blob.view], edit.open(buffer)
    start, end = _span(view)
    after = min([limit, *(a for _, (a, _) in _spans(edit, buffer) if a >= end)])
    vacant = data.count(0, end, after) == after - end  # left by an earlier image, or padding
    available = after if vacant else end
    fits = start + len(blob.data) <= available
    data[start:end] = bytes(end - start)
    if fits:
        data[start : start + len(blob.data)] = blob.data
        view["byteLength"] = len(blob.data)
    return fits
