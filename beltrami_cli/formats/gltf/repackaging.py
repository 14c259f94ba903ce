"""From text glTF to binary and back, without loss."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, encoded, glb_pieces
from beltrami_cli.formats.gltf.files import as_uri, is_data, read
from beltrami_cli.formats.gltf.json_text import Tree, revised
from beltrami_cli.formats.gltf.meshopt import EXTENSIONS
from beltrami_cli.formats.gltf.naming import place_pictures
from beltrami_cli.formats.gltf.pictures import media_type
from beltrami_cli.formats.gltf.saving import place_buffers, sidecar_names
from beltrami_cli.formats.model_folder import UnfitReferenceError

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.model_folder import ModelFolder

_ALIGNMENT = 8  # of merged buffers: more than any component needs, and what KHR extensions ask for


def as_gltf(edit: Edit, stem: str, *, moved: bool) -> Written:
    """Return a binary file as text, its BIN chunk as the sidecar ``stem.bin``.

    Raises
    ------
    InputError
        If the BIN chunk is shorter than its buffer.
    """
    tree, buffers = edit.tree, edit.accessors.buffers
    names = sidecar_names(edit.container.root, stem)
    sidecars: dict[str, Bytes] = {}
    if len(buffers) and buffers.source(0) == "chunk":
        data: Bytes = edit.buffers[0] if 0 in edit.buffers else buffers.stored(0)
        length = tree["buffers"][0]["byteLength"]
        name = next(names)
        sidecars[name] = data[:length] if len(data) - length < 4 else data  # without the chunk's padding
        tree["buffers"][0]["uri"] = as_uri(name)
    sidecars |= place_buffers(edit, tree, names, moved=moved)
    sidecars |= place_pictures(edit, tree, stem, moved=moved)
    lost = [chunk for chunk in edit.container.chunks if chunk.kind != BIN_CHUNK]
    notices = [f"{len(lost)} GLB chunk(s) of unknown type cannot be kept in a .gltf file."] if lost else []
    return Written([encoded(revised(edit.container.text, tree))], sidecars, (*edit.notices, *notices))


def as_glb(edit: Edit, beside: ModelFolder) -> Written:
    """Return a text file as binary: all buffers merged into BIN, images inside the folder embedded.

    Parameters
    ----------
    edit : Edit
        The changes.
    beside : ModelFolder
        Where images are looked for.

    Raises
    ------
    InputError
        If a buffer cannot be read.
    """
    tree = edit.tree
    binary = _merge_buffers(edit, tree)
    notices = [*edit.notices, *_embed_images(edit, binary, beside)]
    chunks = []
    if binary:
        tree["buffers"][0]["byteLength"] = len(binary)
        chunks.append(Chunk(BIN_CHUNK, binary))
    text = encoded(revised(edit.container.text, tree).strip(" \t\r\n"))
    return Written(glb_pieces([Chunk(JSON_CHUNK, text), *chunks]), {}, tuple(notices))


def _merge_buffers(edit: Edit, tree: Tree) -> bytearray:
    """Join the bytes of all buffers that have any, and make the tree's views point into the result."""
    buffers, binary = edit.accessors.buffers, bytearray()
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
    numbers = dict.fromkeys(starts, 0) | {index: 1 + rank for rank, index in enumerate(kept)}
    if not starts:
        return binary
    for view in tree.get("bufferViews", []):
        for holder in [view, *view.get("extensions", {}).values()]:
            if not isinstance(holder, dict) or not isinstance(holder.get("buffer"), int):
                continue
            start = starts.get(holder["buffer"], 0)
            holder["buffer"] = numbers.get(holder["buffer"], holder["buffer"])
            if start and isinstance(holder.get("byteOffset", 0), int):
                holder["byteOffset"] = holder.get("byteOffset", 0) + start
    merged = {key: value for key, value in tree["buffers"][next(iter(starts))].items() if key != "uri"}
    if "extensions" in merged:  # it is more than a substitute for what is compressed
        rest = {key: value for key, value in merged.pop("extensions").items() if key not in EXTENSIONS}
        merged |= {"extensions": rest} if rest else {}
    tree["buffers"] = [merged, *(tree["buffers"][index] for index in kept)]
    return binary


def _embed_images(edit: Edit, binary: bytearray, beside: ModelFolder) -> list[str]:
    """Move images from the folder into the binary; return a notice for each that stays outside."""
    notices, tree = [], edit.tree
    for index, image in enumerate(tree.get("images", [])):
        uri = image.get("uri")
        if uri is None or is_data(uri):
            continue
        try:
            new = edit.pictures.get(index)
            data = read(uri, beside) if new is None else new.data
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
