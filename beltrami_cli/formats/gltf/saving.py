"""The files of an edited glTF in either form, binary or text, and the names of its sidecar files.

A new image or buffer never takes the name of a file that the source uses, unless the output replaces the source.
"""

from __future__ import annotations

from urllib.parse import quote

from beltrami_cli.formats.document import Bytes, Naming, Written
from beltrami_cli.formats.gltf.buffers import (
    MESHOPT,
    data_uri,
    is_data,
    located,
    named_files,
    read,
    relative_name,
)
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, Tree, glb_pieces, revised
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.textures import media_type
from beltrami_cli.formats.model_folder import ModelFolder, NewFiles, UnfitReferenceError, is_outside
from beltrami_cli.surface.records import ImageFile

_ALIGNMENT = 8  # of merged buffers: more than any component needs, and what KHR extensions ask for


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
