"""Where the JSON of a glTF file names its own entries: accessors, views, textures and images.

The walks take plain objects, which may be changed, instead of checked ones; `require_structure` has checked what they
look through.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from beltrami_cli.formats.gltf.buffers import View
from beltrami_cli.formats.gltf.entries import Tree

_WITHOUT_TEXTURES = ("accessors", "animations", "bufferViews", "buffers", "images", "skins", "textures")


def objects_within(value: object) -> Iterator[Tree]:
    """Yield all objects in a value, itself included."""
    stack = [value]
    while stack:
        value = stack.pop()
        if isinstance(value, list):
            stack += value
        elif isinstance(value, dict):
            stack += value.values()
            yield value


def objects(values: object) -> list[Tree]:
    """Return the objects among the values of an array that should hold nothing else."""
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []


def primitives_of(tree: Tree) -> Iterator[tuple[tuple[int, int], Tree]]:
    """Yield the primitives of all meshes, each with the index of its mesh and its own within the mesh."""
    for mesh, holder in enumerate(objects(tree.get("meshes"))):
        for part, primitive in enumerate(objects(holder.get("primitives"))):
            yield (mesh, part), primitive


def accessor_uses(tree: Tree) -> Iterator[tuple[tuple[int, int] | None, Tree, str]]:
    """Yield the references to accessors, as (primitive if it is an attribute of one, holder, key)."""
    # Primitives, objects, and the members of these that refer to accessors; no members: all.
    holders: list[tuple[tuple[int, int] | None, Any, tuple[str, ...]]] = []
    for number, primitive in primitives_of(tree):
        holders += [(number, primitive.get("attributes"), ()), (None, primitive, ("indices",))]
        holders += [(None, target, ()) for target in objects(primitive.get("targets"))]
    for animation in objects(tree.get("animations")):
        holders += [(None, each, ("input", "output")) for each in objects(animation.get("samplers"))]
    holders += [(None, skin, ("inverseBindMatrices",)) for skin in objects(tree.get("skins"))]
    for extensions in objects([node.get("extensions") for node in objects(tree.get("nodes"))]):
        holders += [(None, each.get("attributes"), ()) for each in objects(list(extensions.values()))]
    for place, holder, keys in holders:
        if isinstance(holder, dict):
            yield from ((place, holder, key) for key in keys or holder if isinstance(holder.get(key), int))


def view_spans(tree: Tree, lengths: Sequence[int]) -> Iterator[tuple[tuple[int, str | None], View]]:
    """Yield the bytes that views and their extensions name, with the view's index and extension."""
    for index, view in enumerate(objects(tree.get("bufferViews"))):
        for name, holder in [(None, view), *view.get("extensions", {}).items()]:
            if not isinstance(holder, dict):
                continue
            buffer, offset, length = (holder.get(key, 0) for key in ("buffer", "byteOffset", "byteLength"))
            if isinstance(buffer, int) and isinstance(offset, int) and isinstance(length, int):
                inside = 0 <= buffer < len(lengths) and offset >= 0 and length > 0
                if "buffer" in holder and inside and offset + length <= lengths[buffer]:
                    yield (index, name), View(buffer, offset, length)


def view_references(value: object) -> Iterator[int]:
    """Yield all members called "bufferView" in a value, also in images and unknown extensions."""
    named = (each.get("bufferView") for each in objects_within(value))
    return (index for index in named if isinstance(index, int))


def texture_infos(tree: Tree) -> Iterator[tuple[str, Tree]]:
    """Find the textureInfos of materials and extensions, with their places."""
    for key, value in tree.items():
        if key not in _WITHOUT_TEXTURES:
            yield from _infos_within(value, key, is_texture=_names_texture(key))


def _infos_within(value: Any, place: str, *, is_texture: bool) -> Iterator[tuple[str, Tree]]:
    if isinstance(value, list):
        for index, child in enumerate(value):
            yield from _infos_within(child, f"{place}[{index}]", is_texture=is_texture)
    elif isinstance(value, dict):
        for key, child in list(value.items()):
            names_texture = key != "extras" and (is_texture or _names_texture(key))
            yield from _infos_within(child, f"{place}.{key}", is_texture=names_texture)
        if is_texture and isinstance(value.get("index"), int):
            yield place, value


def _names_texture(name: str) -> bool:
    # In materials every `index` is that of a texture. Elsewhere, and in data of applications, it may be that of
    # anything, such as a morph target in VRM.
    return name.startswith("materials") or "texture" in name.lower()


def image_uses(tree: Tree) -> Iterator[tuple[Any, Any]]:
    """Yield the places that name images: the object or array, and its member."""
    for texture in tree["textures"]:
        for holder in [texture, *objects(list(texture.get("extensions", {}).values()))]:
            if isinstance(holder.get("source"), int):
                yield holder, "source"
    lights = tree.get("extensions", {}).get("EXT_lights_image_based", {})
    stack: list[Any] = [light.get("specularImages") for light in objects(lights.get("lights"))]
    for value in stack:
        if isinstance(value, list):
            stack += [child for child in value if isinstance(child, list)]
            yield from ((value, place) for place, child in enumerate(value) if isinstance(child, int))
