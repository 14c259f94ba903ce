"""The files of an edited glTF file: their names, and the form of the main one.

A new image or buffer never takes the name of a file that the source uses, unless the output replaces the source.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from urllib.parse import quote

from beltrami_cli.formats.changes import Bytes, Naming, Written
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, glb_pieces
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.entries import Tree
from beltrami_cli.formats.gltf.images import media_type
from beltrami_cli.formats.gltf.json_text import revised
from beltrami_cli.formats.gltf.meshopt import MESHOPT
from beltrami_cli.formats.gltf.references import objects
from beltrami_cli.formats.gltf.uris import SidecarFiles, data_uri, is_data, locate_uri, quoted_uri, read_uri
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError, is_outside
from beltrami_cli.formats.sidecars.new_files import NewFiles
from beltrami_cli.surface.records import ImageFile

_ALIGNMENT = 8  # of merged buffers: enough for all component types, and required by KHR extensions


def write_files(edit: Edit, naming: Naming, form: str, source: SidecarFiles) -> Written:
    """Return the files of an edit; the source itself if nothing was edited and the form is its own."""
    container, keeps_form = edit.container, (form == "gltf") == (edit.container.kind == "gltf")
    if form != "gltf" and not keeps_form:
        return _as_glb(edit, source.folder)
    edit.finish()
    names = place_files(edit, naming, form, source)
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


def place_files(edit: Edit, naming: Naming, form: str, source: SidecarFiles) -> NewFiles:
    """Name the sidecar files of an edited glTF, and put their names into the tree."""
    names = NewFiles(naming, edit.container.name, source.present, source.missing)
    files = [*_files(edit, source.folder)]
    if form == "gltf" and edit.tree.get("buffers") and edit.source(0) == "chunk":
        _place_chunk(edit, names)
    # Only one image takes the name of a file, and none if another still shows that.
    taken = {path for _, path, new in files if new is None}
    new_of: dict[tuple[str, ImageFile | None], str] = {}
    for entry, path, new in files:
        if new is None and (not names.is_moved or path in source.missing):
            continue
        if new is None and is_outside(path):
            names.leave(entry["uri"])
            continue
        image = new if isinstance(new, ImageFile) else None
        if (path, image) not in new_of:
            if "byteLength" in entry:
                name = names.other(path, ".bin")
            elif image is None:
                name = names.image(path)
            else:
                name = names.image(path, image.suffix, is_replaced=path not in taken)
            new_of[path, image] = name
            taken.add(path)
            if new is None:
                names.copies[name] = path
            else:
                names.sidecars[name] = new.data if isinstance(new, ImageFile) else new
        if new_of[path, image] != path:
            entry["uri"] = quote(new_of[path, image])
    return names


def _place_chunk(edit: Edit, names: NewFiles) -> None:
    """Make the BIN chunk a file."""
    data: Bytes = edit.buffers[0] if 0 in edit.buffers else edit.accessors.buffers.stored(0)
    length, name = edit.tree["buffers"][0]["byteLength"], names.new(".bin")
    edit.tree["buffers"][0]["uri"] = quote(name)
    names.sidecars[name] = data[:length] if len(data) - length < 4 else data  # without the padding


def _files(edit: Edit, folder: ModelFolder) -> Iterator[tuple[Tree, str, Bytes | ImageFile | None]]:
    """Yield the buffers and images that are files: entry, path, and new content if it changes.

    Buffers that are data URIs get theirs.
    """
    canonical = edit.accessors.buffers.canonical
    buffers = [(each, edit.buffers.get(canonical(n))) for n, each in enumerate(edit.tree.get("buffers", []))]
    images = [(each, edit.images.get(n)) for n, each in enumerate(edit.tree.get("images", []))]
    for entry, new in [*buffers, *images]:
        uri = entry.get("uri")
        if uri is not None and not is_data(uri):
            with suppress(UnfitReferenceError):
                yield entry, locate_uri(uri, folder, must_exist=False), new
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
            data = read_uri(uri, folder) if new is None else new.data
            kind = image.get("mimeType") or media_type(data)
            if kind is None:
                raise UnfitReferenceError("is of an unknown type, so it cannot be embedded")
        except UnfitReferenceError as error:
            edit.notices.append(f"images[{index}] stays outside the GLB: {quoted_uri(uri)} {error}.")
            continue
        view = edit.add("bufferViews", {})
        edit.put(edit.growing_buffer([]), (view, None), data)
        del image["uri"]
        image |= {"bufferView": view, "mimeType": kind}


def _merge_buffers(edit: Edit) -> bytearray:
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
