"""A glTF file taken apart, for comparison with another.

Indices of the JSON are compared as they are, for a patch never moves what is there; what it appends is seen from what
refers to it. Numbers are compared as accessors give them, so that it counts as no difference where colours are stored.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import DRACO, Accessors
from beltrami_cli.formats.gltf.buffers import named_views
from beltrami_cli.formats.gltf.container import Container, Tree, objects, primitives_of
from beltrami_cli.formats.gltf.edit import used_otherwise
from beltrami_cli.formats.gltf.textures import IMAGE_EXTENSIONS, Images, texture_infos
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.surface.records import Texture

_SHARED = ("accessors", "bufferViews", "buffers", "images", "textures", "materials", "meshes")
_PLACE = ("uri", "bufferView", "mimeType")  # of an image
_NUMBERS_OF_COLOURS = ("bufferView", "byteOffset", "sparse", "min", "max")
_PACKED_PLACE = ("buffer", "byteOffset", "byteLength")  # of compressed bytes, in the extension of a view


def fingerprint(
    container: Container, accessors: Accessors, images: Images
) -> tuple[dict[str, bytes], dict[str, Texture]]:
    """Return all parts of a glTF file but its colours and images, and its images."""
    tree, paintings = container.copy_of_tree(), dict[str, Texture]()
    parts = dict(_plain_parts(container, tree)) | _materials(images, tree, paintings) | _meshes(tree)
    return parts | _numbers(accessors, container.tree, tree), paintings


def _plain_parts(container: Container, tree: Tree) -> Iterator[tuple[str, bytes]]:
    """Give what no patch changes."""
    for key, value in tree.items():
        if key in ("extensionsUsed", "extensionsRequired"):
            if kept := [name for name in value if name not in IMAGE_EXTENSIONS]:
                yield key, _spelled(kept)
        elif key not in _SHARED and isinstance(value, list):
            yield from ((f"{key}[{index}]", _spelled(entry)) for index, entry in enumerate(value))
        elif key not in _SHARED:
            yield key, _spelled(value)
    for index, buffer in enumerate(objects(tree.get("buffers"))):
        if others := {key: value for key, value in buffer.items() if key not in ("uri", "byteLength")}:
            yield f"buffers[{index}]", _spelled(others)
    for index, chunk in enumerate(container.unknown_chunks):
        yield f"chunk {index} of type {chunk.kind:#x}", bytes(chunk.data)
    yield "what follows the last chunk", bytes(container.tail)
    yield "byte order mark", bytes([container.has_bom])


def _materials(images: Images, tree: Tree, paintings: dict[str, Texture]) -> dict[str, bytes]:
    """Return the materials with what their textures say of images and samplers, and note the images."""
    parts, shown = {}, set()
    others = {key: value for key, value in tree.items() if key not in _SHARED or key == "meshes"}
    elsewhere = {info["index"] for key, value in others.items() for _, info in texture_infos(value, key)}
    for index, material in enumerate(objects(tree.get("materials"))):
        for place, info in texture_infos(material, f"materials[{index}]"):
            number = info.pop("index")
            if 0 <= number < len(images.textures):
                shown.add(number)
                info["texture"] = _texture(images, tree, number, place, paintings)
        parts[f"materials[{index}]"] = _spelled(material)
    for number in range(len(images.textures)):
        if number not in shown or number in elsewhere:
            place = f"textures[{number}]"
            parts[place] = _spelled(_texture(images, tree, number, place, paintings))
    return parts


def _texture(images: Images, tree: Tree, number: int, place: str, paintings: dict[str, Texture]) -> Tree:
    """Return a texture without where its image is, and note the image."""
    texture = dict(tree["textures"][number])
    texture.pop("source", None)
    kept = {k: v for k, v in texture.pop("extensions", {}).items() if k not in IMAGE_EXTENSIONS}
    try:
        image = images.shown(number)
        paintings[place] = Texture(place, images.name(image), images.data(image))
    except UnfitReferenceError as error:
        return texture | {"extensions": kept, "image": str(error)}
    others = {key: value for key, value in tree["images"][image].items() if key not in _PLACE}
    return texture | {"extensions": kept, "image": others}


def _meshes(tree: Tree) -> dict[str, bytes]:
    """Return the meshes, and what the accessors of their colours say but for the numbers."""
    parts = {}
    accessors = objects(tree.get("accessors"))
    for index, mesh in enumerate(objects(tree.get("meshes"))):
        for number, primitive in enumerate(objects(mesh.get("primitives"))):
            colour = primitive.get("attributes", {}).get("COLOR_0")
            if colour is not None and 0 <= colour < len(accessors):
                kept = {k: v for k, v in accessors[colour].items() if k not in _NUMBERS_OF_COLOURS}
                kept["bounds"] = [key for key in ("min", "max") if key in accessors[colour]]
                parts[f"colours of meshes[{index}].primitives[{number}]"] = _spelled(kept)
            packed = primitive.get("extensions", {}).get(DRACO, {})
            for attributes in (primitive.get("attributes", {}), packed.get("attributes", {})):
                attributes.pop("COLOR_0", None)
        parts[f"meshes[{index}]"] = _spelled(mesh)
    return parts


def _numbers(accessors: Accessors, source: Tree, tree: Tree) -> dict[str, bytes]:
    """Return the accessors that are not only colours, with their numbers, and the views that they look through."""
    parts: dict[str, bytes] = {}
    others = used_otherwise(tree, "COLOR_0")
    colours = {primitive.get("attributes", {}).get("COLOR_0") for _, primitive in primitives_of(source)}
    opaque = set(named_views({k: v for k, v in tree.items() if k not in ("images", "accessors")}))
    views = set(opaque)
    for index, accessor in enumerate(objects(tree.get("accessors"))):
        if index in colours and index not in others:
            continue
        views |= set(named_views(accessor))
        try:
            numbers = accessors.stored(index).tobytes()
        except InputError as error:
            numbers = str(error.cause).encode()
        parts[f"accessors[{index}]"] = _spelled(accessor) + numbers
    for index in sorted(views & set(range(len(accessors.views)))):  # extensions may name others, or none
        parts[f"bufferViews[{index}]"] = _spelled(_view(tree["bufferViews"][index]))
        if index in opaque:  # such as geometry compressed with Draco
            parts[f"bytes of bufferViews[{index}]"] = accessors.buffers.viewed(accessors.views[index])
    return parts


def _view(view: Tree) -> Tree:
    """Return a view without the place of its compressed bytes, as they are compressed again with new colours."""
    extensions = dict(view.get("extensions", {}))
    for name, holder in extensions.items():
        if isinstance(holder, dict):
            extensions[name] = {k: v for k, v in holder.items() if k not in _PACKED_PLACE}
    return view | ({"extensions": extensions} if extensions else {})


def _spelled(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, ensure_ascii=False).encode("utf-8", "surrogatepass")
