"""The files of an edited glTF in either form, binary or text, and where they store new images and buffers.

A new image or buffer never takes the name of a file that the source uses, unless the output replaces the source.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from urllib.parse import quote

from beltrami_cli.formats.document import Bytes, Naming, Written
from beltrami_cli.formats.gltf.buffers import (
    MESHOPT,
    SidecarFiles,
    data_uri,
    is_data,
    located,
    read,
    short,
)
from beltrami_cli.formats.gltf.container import (
    BIN_CHUNK,
    JSON_CHUNK,
    Chunk,
    Tree,
    glb_pieces,
    objects,
    objects_within,
    revised,
)
from beltrami_cli.formats.gltf.edit import Edit
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


def put_images(edit: Edit, files: Mapping[int, ImageFile]) -> None:
    """Give images new files, stored as the old ones are: in a buffer, in a data URI, or as a file."""
    images = edit.tree["images"]
    for index, file in files.items():
        image, media = images[index], MEDIA[file.suffix.lower()]
        if "bufferView" in image or "mimeType" in image:
            image["mimeType"] = media
        if "bufferView" not in image and is_data(image["uri"]):
            is_same = image["uri"][5:].partition(",")[0].partition(";")[0].lower() == media
            image["uri"] = data_uri(image["uri"] if is_same else f"data:{media};base64,", file.data)
        elif "bufferView" not in image:
            edit.images[index] = file
    file_of = {id(images[index]): file for index, file in files.items()}
    holders = [*images, *objects_within({key: value for key, value in edit.tree.items() if key != "images"})]
    # What an extension says of a view is not known to be true of other bytes.
    holders += [
        {"bufferView": n} for n, view in enumerate(edit.tree.get("bufferViews", [])) if "extensions" in view
    ]
    named = [holder for holder in holders if isinstance(holder.get("bufferView"), int)]
    uses = [(holder, "bufferView", file_of.get(id(holder))) for holder in named]
    for (old, file), view in edit.separate("bufferViews", uses, copied=lambda _: {}).items():
        home = edit.growing_buffer([edit.tree["bufferViews"][old]["buffer"]])
        edit.put(home, (view, None), file.data)


def written(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> Written:
    """Return the files of an edit; the source itself if nothing was edited and the form is its own."""
    container, keeps_form = edit.container, form == edit.container.kind
    if form == "glb" and not keeps_form:
        return _as_glb(edit, folder)
    edit.finish()
    names = _placed(edit, naming, form, folder)
    if not keeps_form:
        main: list[Bytes] = [revised(container.text, edit.tree).encode()]
        lost = [chunk for chunk in container.chunks if chunk.kind != BIN_CHUNK]
        if lost:
            edit.notices.append(f"{len(lost)} GLB chunk(s) of unknown type cannot be kept in a .gltf file.")
    elif not edit.buffers and not edit.images and edit.tree == container.tree:
        main = [container.data]
    else:
        main = container.rebuilt(edit.tree, edit.buffers.get(0) if edit.source(0) == "chunk" else None)
    return names.written(main, edit.notices)


def sidecar_names(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> list[str]:
    """Return the names of the sidecar files that `written` returns."""
    edit.finish()
    return _placed(edit, naming, form, folder).written().sidecar_names


def _placed(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> NewFiles:
    """Name the sidecar files of an edited glTF, and put their names into the tree."""
    used = SidecarFiles(edit.container.root, folder)
    names = NewFiles(naming, edit.container.name, used.present, used.missing)
    files = [*_files(edit, folder)]
    if form == "gltf" and edit.tree.get("buffers") and edit.source(0) == "chunk":
        data: Bytes = edit.buffers[0] if 0 in edit.buffers else edit.accessors.buffers.stored(0)
        length, name = edit.tree["buffers"][0]["byteLength"], names.new(".bin")
        edit.tree["buffers"][0]["uri"] = quote(name)
        names.sidecars[name] = data[:length] if len(data) - length < 4 else data  # without the padding
    # Only one image takes the name of a file, and none if another still shows that.
    taken = {path for _, path, new in files if new is None}
    new_of: dict[tuple[str, ImageFile | None], str] = {}
    for entry, path, new in files:
        if new is None and (not names.copies or path in used.missing):
            continue
        if new is None and is_outside(path):
            names.leave(entry["uri"])
            continue
        file = new if isinstance(new, ImageFile) else None
        if (path, file) not in new_of:
            is_buffer = "byteLength" in entry
            suffix, is_replaced = None if file is None else file.suffix, file is None or path not in taken
            name = (
                names.other(path, ".bin") if is_buffer else names.image(path, suffix, is_replaced=is_replaced)
            )
            new_of[path, file] = name
            taken.add(path)
            if new is None:
                names.copied[name] = path
            else:
                names.sidecars[name] = new.data if isinstance(new, ImageFile) else new
        if new_of[path, file] != path:
            entry["uri"] = quote(new_of[path, file])
    return names


def _files(edit: Edit, folder: ModelFolder) -> Iterator[tuple[Tree, str, Bytes | ImageFile | None]]:
    """Iterate over the buffers and images that are files: entry, path, and new content if it changes.

    Buffers that are data URIs get theirs.
    """
    canonical = edit.accessors.buffers.canonical
    buffers = [(each, edit.buffers.get(canonical(n))) for n, each in enumerate(edit.tree.get("buffers", []))]
    images = [(each, edit.images.get(n)) for n, each in enumerate(edit.tree.get("images", []))]
    for entry, new in [*buffers, *images]:
        uri = entry.get("uri")
        if uri is not None and not is_data(uri):
            with suppress(UnfitReferenceError):
                yield entry, located(uri, folder, must_exist=False), new
        elif uri is not None and isinstance(new, bytearray):
            entry["uri"] = data_uri(uri, new)


def _as_glb(edit: Edit, folder: ModelFolder) -> Written:
    """Return a text file as binary: all buffers merged into BIN, images inside the folder embedded."""
    _embed_images(edit, folder)
    edit.finish()
    binary = _merge_buffers(edit)
    chunks = [Chunk(JSON_CHUNK, revised(edit.container.text, edit.tree).strip(" \t\r\n").encode())]
    chunks += [Chunk(BIN_CHUNK, binary)] if binary else []
    return Written(glb_pieces(chunks), notices=tuple(edit.notices))


def _embed_images(edit: Edit, folder: ModelFolder) -> None:
    """Put images from the folder into a buffer; a notice names each that stays outside."""
    for index, image in enumerate(edit.tree.get("images", [])):
        uri = image.get("uri")
        if uri is None or is_data(uri):
            continue
        try:
            new = edit.images.get(index)
            data = read(uri, folder) if new is None else new.data
            kind = image.get("mimeType") or media_type(data)
            if kind is None:
                raise UnfitReferenceError("is of an unknown type, so it cannot be embedded")
        except UnfitReferenceError as error:
            edit.notices.append(f"images[{index}] stays outside the GLB: {short(uri)} {error}.")
            continue
        view = edit.add("bufferViews", {})
        edit.put(edit.growing_buffer([]), (view, None), data)
        del image["uri"]
        image |= {"bufferView": view, "mimeType": kind}


def _merge_buffers(edit: Edit) -> bytearray:
    """Join the bytes of all buffers that have any, and make the views point into the result."""
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
    if "extensions" in merged:  # it is more than a fallback for compressed data
        others = {key: value for key, value in merged.pop("extensions").items() if key not in MESHOPT}
        merged |= {"extensions": others} if others else {}
    tree["buffers"] = [merged, *(entries[index] for index in kept)]
    return binary
