"""The contents of a glTF file for comparison: everything but colours and images, and the images."""

from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.container import Container
from beltrami_cli.formats.gltf.draco import DRACO
from beltrami_cli.formats.gltf.entries import Tree
from beltrami_cli.formats.gltf.images import IMAGE_EXTENSIONS, Images
from beltrami_cli.formats.gltf.references import (
    accessor_uses,
    objects,
    primitives_of,
    texture_infos,
    view_references,
)
from beltrami_cli.formats.sidecars.model_folder import UnfitReferenceError
from beltrami_cli.surface.records import Texture

_PLACE_OF_BUFFER, _PLACE_OF_IMAGE = ("uri", "byteLength"), ("uri", "bufferView", "mimeType")
_NUMBERS_OF_COLOURS = ("bufferView", "byteOffset", "sparse", "min", "max")
_PACKED_PLACE = ("buffer", "byteOffset", "byteLength")  # of compressed bytes, in the extension of a view


def fingerprint(
    container: Container, accessors: Accessors, images: Images
) -> tuple[dict[str, bytes], dict[str, Texture]]:
    """Return all parts of a glTF file but its colours and images, and its images."""
    # Entries that a patch may add or that say where images and colours are stored become None.
    tree, textures = container.copy_of_tree(), dict[str, Texture]()
    parts = {f"chunk {n} of type {c.kind:#x}": bytes(c.data) for n, c in enumerate(container.unknown_chunks)}
    parts["what follows the last chunk"] = bytes(container.tail)
    parts["byte order mark"] = bytes([container.has_bom])
    for key in ("extensionsUsed", "extensionsRequired"):
        tree[key] = [name for name in tree.get(key, []) if name not in IMAGE_EXTENSIONS]
    tree["buffers"] = [_without(each, _PLACE_OF_BUFFER) or None for each in tree.get("buffers", [])]
    _hide_images(images, tree, textures)
    parts |= _hide_colours(tree) | _numbers(accessors, container.tree, tree)
    for key, value in tree.items():
        entries = {key: value}
        if isinstance(value, list):
            entries = {f"{key}[{n}]": each for n, each in enumerate(value)}
        parts |= {place: _spelled(each) for place, each in entries.items() if each is not None}
    return parts, textures


def _hide_images(images: Images, tree: Tree, textures: dict[str, Texture]) -> None:
    """Describe textures where materials name them, without where their images are, and note the images."""
    # Textures that something else shows, too, stay described in their own place.
    infos, shown = list(texture_infos(tree)), set[int]()
    of_materials = [(place, info) for place, info in infos if place.startswith("materials[")]
    elsewhere = {info["index"] for place, info in infos if not place.startswith("materials[")}
    for place, info in of_materials:
        number = info.pop("index")
        if 0 <= number < len(images.textures):
            shown.add(number)
            info["texture"] = _texture(images, tree, number, place, textures)
    tree["textures"] = [
        _texture(images, tree, number, f"textures[{number}]", textures)
        if number not in shown or number in elsewhere
        else None
        for number in range(len(images.textures))
    ]
    tree.pop("images", None)


def _texture(images: Images, tree: Tree, number: int, place: str, textures: dict[str, Texture]) -> Tree:
    """Return a texture without where its image is, and note the image."""
    texture = _without(tree["textures"][number], ("source",))
    texture["extensions"] = _without(texture.get("extensions", {}), IMAGE_EXTENSIONS)
    try:
        image = images.shown(number)
        textures[place] = Texture(place, images.name(image), images.data(image))
    except UnfitReferenceError as error:
        return texture | {"image": str(error)}
    return texture | {"image": _without(tree["images"][image], _PLACE_OF_IMAGE)}


def _hide_colours(tree: Tree) -> dict[str, bytes]:
    """Take the colours of vertices out of a tree; return what their accessors say but for the numbers."""
    parts, accessors = {}, objects(tree.get("accessors"))
    for (mesh, number), primitive in primitives_of(tree):
        packed = primitive.get("extensions", {}).get(DRACO, {})
        packed.get("attributes", {}).pop("COLOR_0", None)
        colour = primitive.get("attributes", {}).pop("COLOR_0", -1)
        if 0 <= colour < len(accessors):
            kept = _without(accessors[colour], _NUMBERS_OF_COLOURS)
            kept["bounds"] = [key for key in ("min", "max") if key in accessors[colour]]
            parts[f"colours of meshes[{mesh}].primitives[{number}]"] = _spelled(kept)
    return parts


def _numbers(accessors: Accessors, source: Tree, tree: Tree) -> dict[str, bytes]:
    """Return the numbers of accessors, and the bytes of other views; hide accessors and views of colours alone."""
    parts: dict[str, bytes] = {}
    used = {holder[key] for _, holder, key in accessor_uses(tree)}
    colours = {primitive.get("attributes", {}).get("COLOR_0") for _, primitive in primitives_of(source)}
    opaque = set(view_references(_without(tree, ("accessors",))))
    views = set(opaque)
    for index, accessor in enumerate(tree.get("accessors", [])):
        if index in colours and index not in used:
            tree["accessors"][index] = None
            continue
        views |= set(view_references(accessor))
        try:
            parts[f"numbers of accessors[{index}]"] = accessors[index].stored().tobytes()
        except InputError as error:
            parts[f"numbers of accessors[{index}]"] = str(error.cause).encode()
    for index, view in enumerate(tree.get("bufferViews", [])):
        tree["bufferViews"][index] = _view(view) if index in views else None
        if index in opaque:  # such as geometry compressed with Draco
            parts[f"bytes of bufferViews[{index}]"] = accessors.buffers.viewed(accessors.views[index])
    return parts


def _view(view: Tree) -> Tree:
    """Return a view without the place of its compressed bytes, as they are compressed again with new colours."""
    extensions = dict(view.get("extensions", {}))
    for name, holder in extensions.items():
        if isinstance(holder, dict):
            extensions[name] = _without(holder, _PACKED_PLACE)
    return view | ({"extensions": extensions} if extensions else {})


def _without(entry: Tree, members: Collection[str]) -> Tree:
    return {key: value for key, value in entry.items() if key not in members}


def _spelled(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, ensure_ascii=False).encode("utf-8", "surrogatepass")
