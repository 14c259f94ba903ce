"""The files of an edited glTF in either form, binary or text, and where they store new images and buffers.

New images go over the old ones, to the end of the buffer, into a data URI, or into a file. A new image or buffer never
takes the name of a file that the source uses, unless the output replaces the source.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from beltrami_cli.formats.document import Bytes, Naming, Written
from beltrami_cli.formats.gltf.buffers import (
    MESHOPT,
    data_uri,
    is_data,
    located,
    named_files,
    named_places,
    named_views,
    read,
    relative_name,
)
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, Tree, glb_pieces, revised
from beltrami_cli.formats.gltf.edit import Edit, is_unshared
from beltrami_cli.formats.image import format_of
from beltrami_cli.formats.image.picture import FORMATS
from beltrami_cli.formats.model_folder import ModelFolder, NewFiles, UnfitReferenceError, is_outside
from beltrami_cli.surface.records import ImageFile

_HELD = ("png", "jpeg", "webp", "ktx2", "avif")
MEDIA = {suffix: f"image/{known}" for known in _HELD for suffix in FORMATS[known].suffixes}
"""Media types of the images that glTF can hold, by suffix."""

_ALIGNMENT = 8  # of merged buffers: more than any component needs, and what KHR extensions ask for


def media_type(data: bytes) -> str | None:
    """Return the media type that the first bytes of an image show, if it is one that glTF knows."""
    known = format_of(data, "")
    return f"image/{known}" if known in _HELD else None


def written(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> Written:
    """Return the files of an edit; the source itself if nothing was edited and the form is its own."""
    container, keeps_form = edit.container, form == edit.container.kind
    if form == "glb" and not keeps_form:
        return _as_glb(edit, folder)
    names = placed(edit, naming, form, folder)
    if not keeps_form:
        main: list[Bytes] = [revised(container.text, edit.tree).encode()]
        lost = [chunk for chunk in container.chunks if chunk.kind != BIN_CHUNK]
        if lost:
            edit.notices.append(f"{len(lost)} GLB chunk(s) of unknown type cannot be kept in a .gltf file.")
    elif not edit.buffers and not edit.images and edit.tree == container.tree:
        main = [container.data]
    else:
        main = container.rebuilt(edit.tree, edit.buffers.get(0) if _source(edit, 0) == "chunk" else None)
    return names.written(main, edit.notices)


def placed(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> NewFiles:
    """Name the sidecar files of an edited glTF, and put their names into the tree."""
    used = named_files(edit.container.root, folder)
    names = NewFiles(naming, edit.container.name, used, [name for name in used if folder.find(name) is None])
    if form != edit.container.kind:
        _place_chunk(edit, names)
    _place_buffers(edit, names, folder)
    _place_images(edit, names, folder)
    _place_copies(edit, names, folder)
    return names


def _place_chunk(edit: Edit, names: NewFiles) -> None:
    """Make a sidecar of the BIN chunk of a binary file that becomes text."""
    tree, buffers = edit.tree, edit.accessors.buffers
    if not len(buffers) or buffers.source(0) != "chunk":
        return
    data: Bytes = edit.buffers[0] if 0 in edit.buffers else buffers.stored(0)
    length, name = tree["buffers"][0]["byteLength"], names.new(".bin")
    tree["buffers"][0]["uri"] = quote(name)
    names.sidecars[name] = data[:length] if len(data) - length < 4 else data  # without the chunk's padding


def _as_glb(edit: Edit, folder: ModelFolder) -> Written:
    """Return a text file as binary: all buffers merged into BIN, images inside the folder embedded."""
    tree, binary = edit.tree, _merge_buffers(edit)
    notices = (*edit.notices, *_embed_images(edit, binary, folder))
    if binary:
        tree["buffers"][0]["byteLength"] = len(binary)
    chunks = [Chunk(JSON_CHUNK, revised(edit.container.text, tree).strip(" \t\r\n").encode())]
    return Written(glb_pieces(chunks + ([Chunk(BIN_CHUNK, binary)] if binary else [])), notices=notices)


def _place_buffers(edit: Edit, names: NewFiles, folder: ModelFolder) -> None:
    """Put changed buffers into data URIs or sidecars; the BIN chunk is not among them."""
    entries, buffers = edit.tree.get("buffers", []), edit.accessors.buffers
    for index, data in edit.buffers.items():
        source = _source(edit, index)
        if source == "data":
            entries[index]["uri"] = data_uri(entries[index]["uri"], data)
        elif source == "file":
            old = relative_name(buffers.uris[index] or "", folder, outside=True)
            name = names.other(old, ".bin")
            names.sidecars[name] = data
            for other in range(len(buffers)):
                if buffers.canonical(other) == index and name != old:
                    entries[other]["uri"] = quote(name)


def _source(edit: Edit, index: int) -> str:
    buffers = edit.accessors.buffers
    if index >= len(buffers):  # one that the edit added
        return "data" if index in edit.buffers else "nowhere"
    return buffers.source(index)


def _place_images(edit: Edit, names: NewFiles, folder: ModelFolder) -> None:
    """Name the new image files, and put their names into the tree."""
    chosen: dict[tuple[str, bool, ImageFile], str] = {}
    entries, known = edit.tree.get("images", []), len(edit.container.root.entries("images"))
    for index, file in edit.images.items():
        old = relative_name(entries[index]["uri"], folder, outside=True)
        key = old, index < known, file
        if key not in chosen:
            # A copy of an image never keeps the name of that.
            chosen[key] = names.image(old, file.suffix, is_replaced=index < known)
            names.sidecars[chosen[key]] = file.data
        if chosen[key] != old:
            entries[index]["uri"] = quote(chosen[key])


def _place_copies(edit: Edit, names: NewFiles, folder: ModelFolder) -> None:
    """Give files that stay as they are their names in another folder."""
    new_of: dict[str, str] = {}
    for kind in ("buffers", "images") if names.copies else ():
        for index, entry in enumerate(edit.tree.get(kind, [])):
            uri, buffers = entry.get("uri"), edit.accessors.buffers
            is_new = index >= len(buffers) or buffers.canonical(index) in edit.buffers
            if uri is None or is_data(uri) or (is_new if kind == "buffers" else index in edit.images):
                continue
            try:
                path = located(uri, folder)
            except UnfitReferenceError:
                continue
            if is_outside(path):
                names.leave(uri)
                continue
            if path not in new_of:
                new_of[path] = names.image(path) if kind == "images" else names.other(path, ".bin")
            entry["uri"] = quote(new_of[path])
    names.copied |= {new: path for path, new in new_of.items()}


def _merge_buffers(edit: Edit) -> bytearray:
    """Join the bytes of all buffers that have any, and make the views point into the result."""
    tree, buffers, binary = edit.tree, edit.accessors.buffers, bytearray()
    starts: dict[int, int] = {}
    kept: list[int] = []
    for index in range(len(tree.get("buffers", []))):
        source = buffers.source(index) if index < len(buffers) else "data"
        first = buffers.canonical(index) if index < len(buffers) else index
        if source == "nowhere":
            kept.append(index)
        elif first in starts:
            starts[index] = starts[first]
        else:
            binary += bytes(-len(binary) % _ALIGNMENT)
            starts[index] = len(binary)
            binary += edit.buffers[index] if index in edit.buffers else buffers.stored(index)
    if starts:
        numbers = dict.fromkeys(starts, 0) | {index: 1 + rank for rank, index in enumerate(kept)}
        _renumber_buffers(tree, starts, numbers)
        merged = {key: value for key, value in tree["buffers"][next(iter(starts))].items() if key != "uri"}
        if "extensions" in merged:  # it is more than a fallback for compressed data
            rest = {key: value for key, value in merged.pop("extensions").items() if key not in MESHOPT}
            merged |= {"extensions": rest} if rest else {}
        tree["buffers"] = [merged, *(tree["buffers"][index] for index in kept)]
    return binary


def _renumber_buffers(tree: Tree, starts: dict[int, int], numbers: dict[int, int]) -> None:
    """Give the views, and their extensions, the new numbers of buffers, and offsets from where these start now."""
    for view in tree.get("bufferViews", []):
        for holder in [view, *view.get("extensions", {}).values()]:
            if not isinstance(holder, dict) or not isinstance(holder.get("buffer"), int):
                continue
            start = starts.get(holder["buffer"], 0)
            holder["buffer"] = numbers.get(holder["buffer"], holder["buffer"])
            if start and isinstance(holder.get("byteOffset", 0), int):
                holder["byteOffset"] = holder.get("byteOffset", 0) + start


def _embed_images(edit: Edit, binary: bytearray, folder: ModelFolder) -> list[str]:
    """Move images from the folder into the binary; return a notice for each that stays outside."""
    notices, tree = [], edit.tree
    for index, image in enumerate(tree.get("images", [])):
        uri = image.get("uri")
        if uri is None or is_data(uri):
            continue
        try:
            new = edit.images.get(index)
            data = read(uri, folder) if new is None else new.data
            kind = image.get("mimeType") or media_type(data)
            if kind is None:
                raise UnfitReferenceError("its type is not known, so it cannot be embedded")
        except UnfitReferenceError as error:
            notices.append(f"images[{index}] stays outside the GLB: {error}.")
            continue
        views, buffers = tree.setdefault("bufferViews", []), tree.setdefault("buffers", [])
        if not binary:
            buffers.insert(0, {"byteLength": 0})
        binary += bytes(-len(binary) % 4)
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data
        del image["uri"]
        image |= {"bufferView": len(views) - 1, "mimeType": kind}
    return notices


@dataclass(frozen=True)
class _Blob:
    """An image for a buffer."""

    data: bytes
    view: int | None  # which it may overwrite; None: it needs its own
    images: tuple[int, ...]  # that show it


class ImageStorage:
    """New images while they are collected; `finish` puts images in buffers into place together."""

    def __init__(self, edit: Edit, same: Callable[[int], tuple[int, ...]]) -> None:
        # `same` gives all images over the bytes of one.
        self._edit, self._same = edit, same
        self._named = Counter(named_views(edit.tree))
        self.blobs: dict[int, list[_Blob]] = defaultdict(list)  # by the buffer that `finish` puts them into

    def replace(self, image: int, file: ImageFile) -> int:
        """Give an image and its duplicates other bytes; return its index."""
        group = self._same(image)
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
        elif is_data(image["uri"]):
            same = image["uri"][5:].partition(",")[0].partition(";")[0].lower() == media
            image["uri"] = data_uri(image["uri"] if same else f"data:{media};base64,", file.data)
        else:
            self._edit.images |= dict.fromkeys(group, file)

    def finish(self) -> None:
        for buffer, blobs in self.blobs.items():
            _store(self._edit, buffer, blobs)


def _store(edit: Edit, buffer: int, blobs: Sequence[_Blob]) -> None:
    """Put images into one buffer: each where old ones leave room, or at the end."""
    views, data = edit.tree["bufferViews"], edit.open(buffer)
    # A view that only an image uses may be overwritten, if no other view shares its bytes.
    own = {
        blob.view
        for blob in blobs
        if blob.view is not None and is_unshared(edit, (blob.view, None), buffer, *_span(views[blob.view]))
    }
    taken = [span for view, span in _spans(edit, buffer) if view not in own]
    for start, end in (_span(views[view]) for view in own):
        data[start:end] = bytes(end - start)
    last = max((end for _, end in taken), default=0)
    if data.count(0, last) == len(data) - last:
        del data[last:]
    edit.tree["buffers"][buffer]["byteLength"] = len(data)
    vacant = [(start, end) for start, end in _gaps(taken) if data.count(0, start, end) == end - start]
    for blob in blobs:
        size = len(blob.data)
        chosen = next((n for n, (start, end) in enumerate(vacant) if size <= end - start), None)
        if chosen is None:
            start = edit.append(buffer, blob.data)
        else:
            start, end = vacant[chosen]
            data[start : start + size] = blob.data
            vacant[chosen] = start + size + -size % 4, end
        place = {"buffer": buffer, "byteOffset": start, "byteLength": size}
        if blob.view in own:
            views[blob.view] |= place
            continue
        index = edit.add_view(place)
        for image in blob.images:
            edit.tree["images"][image]["bufferView"] = index


def _gaps(spans: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Give the bytes between spans, from multiples of four on."""
    at = 0
    for start, end in sorted(spans):
        if start > at:
            yield at, start
        at = max(at, end + -end % 4)


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
