"""Whether the members of a glTF file's JSON are objects, arrays and indices where the specification says so.

Readers check what they use themselves. This is for what is only looked through: where else an image or a number is
used, what differs between two files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from beltrami_cli.formats.gltf.tree import spelled

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.tree import Entry

_EACH = "*"
"""Stands for all members of an object that are not named."""

_OBJECTS = {_EACH: dict[str, Any]()}
_INDICES = {_EACH: int}
_EXTENDED = {"extensions": _OBJECTS}
_PRIMITIVE = {
    "attributes": _INDICES,
    "targets": [_INDICES],
    "indices": int,
    "material": int,
    "extensions": {"KHR_draco_mesh_compression": {"attributes": _INDICES}, **_OBJECTS},
}
_SPARSE = {"indices": {"bufferView": int}, "values": {"bufferView": int}}
_SHAPE = {
    "extensionsUsed": [str],
    "extensionsRequired": [str],
    "accessors": [{"bufferView": int, "sparse": _SPARSE, **_EXTENDED}],
    "animations": [{"samplers": [{"input": int, "output": int}], **_EXTENDED}],
    "buffers": [_EXTENDED],
    "bufferViews": [_EXTENDED],
    "images": [{"bufferView": int, **_EXTENDED}],
    "materials": [_EXTENDED],
    "meshes": [{"primitives": [_PRIMITIVE], **_EXTENDED}],
    "nodes": [{"extensions": {"EXT_mesh_gpu_instancing": {"attributes": _INDICES}, **_OBJECTS}}],
    "skins": [{"inverseBindMatrices": int, **_EXTENDED}],
    "textures": [{"source": int, **_EXTENDED}],
    "extensions": {"EXT_lights_image_based": {"lights": [{}]}, **_OBJECTS},
}
_NAMES = {dict: "an object", list: "an array", int: "an integer", str: "a string"}


def require_structure(root: Entry) -> None:
    """Check the kinds of all members that are looked through.

    Raises
    ------
    InputError
        If one is of another kind, with its place.
    """
    stack: list[tuple[str, Any, Any]] = [("", root.value, _SHAPE)]
    while stack:
        place, value, shape = stack.pop()
        kind: Any = shape if isinstance(shape, type) else type(shape)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise root.fault(place, f"is {spelled(value)} instead of {_NAMES[kind]}")
        if isinstance(shape, list):
            stack += [(f"{place}[{index}]", child, shape[0]) for index, child in enumerate(value)]
        elif isinstance(shape, dict):
            for key, child in value.items():
                if key in shape or _EACH in shape:
                    stack.append(
                        (f"{place}.{key}" if place else key, child, shape.get(key, shape.get(_EACH)))
                    )
