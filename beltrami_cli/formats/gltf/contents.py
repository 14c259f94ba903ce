"""A glTF file seen from outside: its painted triangles for conversion, and facts about it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.accessors import fractions
from beltrami_cli.formats.gltf.materials import present_slots
from beltrami_cli.formats.gltf.sharing import objects
from beltrami_cli.surface.records import MeshContents

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.document import GltfDocument
    from beltrami_cli.formats.gltf.json_text import Tree


def contents_of(document: GltfDocument) -> MeshContents:
    """Return the painted primitives of a document as one mesh in world space.

    Raises
    ------
    InputError
        As `GltfDocument.painted`.
    """
    painted = document.painted()
    return MeshContents(
        positions=painted.positions,
        corners=painted.faces.reshape(-1),
        offsets=np.arange(0, 3 * len(painted.faces) + 1, 3, dtype=np.int64),
        colours=painted.colours,
        encoding="linear",
        stored=painted.stored,
        alpha=_alpha(document),
        normals=normals_of(document),
        left_out=tuple(_left_out(document.container.tree)),
    )


def _alpha(document: GltfDocument) -> NDArray[np.float32] | None:
    stored = document.stored_colours
    if all(numbers.shape[1] == 3 for numbers in stored):
        return None
    return np.concatenate(
        [
            np.clip(fractions(numbers[:, 3]), 0, 1)
            if numbers.shape[1] == 4
            else np.ones(len(numbers), np.float32)
            for numbers in stored
        ]
    )


def normals_of(document: GltfDocument) -> NDArray[np.float32] | None:
    """Return unit normals in world space if every block has them; those of length zero stay zero."""
    parts = []
    for block in document.surface.blocks:
        if block.normal is None:
            return None
        a, b, c = block.placement.matrix[:3, :3].T
        # The cofactor matrix is the inverse transpose times the determinant, and exists for flat scales too.
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        sign = -1.0 if a @ cofactors[:, 0] < 0 else 1.0
        turned = document.accessors.values(block.normal) @ (sign * cofactors).T
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        parts.append(turned / np.where(length > 0, length, 1))
    return np.concatenate(parts).astype(np.float32)


def _primitives(tree: Tree) -> list[Tree]:
    return [part for mesh in objects(tree.get("meshes")) for part in objects(mesh.get("primitives"))]


def _attributes(primitive: Tree) -> Tree:
    attributes = primitive.get("attributes")
    return attributes if isinstance(attributes, dict) else {}


def has_colours(tree: Tree) -> bool:
    """Return whether any primitive has COLOR_0, compressed or not."""
    return any("COLOR_0" in _attributes(primitive) for primitive in _primitives(tree))


def _left_out(tree: Tree) -> Iterator[str]:
    for key in ("materials", "textures", "skins", "animations", "cameras"):
        if tree.get(key):
            yield key
    primitives = _primitives(tree)
    attributes = {key for primitive in primitives for key in _attributes(primitive)}
    if any(primitive.get("targets") for primitive in primitives):
        yield "morph targets"
    if any("COLOR_0" not in _attributes(primitive) for primitive in primitives):
        yield "uncoloured meshes"
    if any(key.startswith("TEXCOORD_") for key in attributes):
        yield "texture coordinates"
    if any(key in ("TANGENT", "COLOR_1") or key.startswith("_") for key in attributes):
        yield "further vertex attributes"
    if any(primitive.get("mode") in (1, 2, 3) for primitive in primitives):
        yield "lines"
    placed = ("children", "matrix", "translation", "rotation", "scale")
    nodes = objects(tree.get("nodes"))
    if len(nodes) > 1 or any(key in node for node in nodes for key in placed):
        yield "node hierarchy"


def summary(document: GltfDocument) -> dict[str, object]:
    """Return facts about a glTF file, in JSON types."""
    root, accessors = document.root, document.accessors
    asset = root.entry("asset")
    colours = {
        index
        for primitive in _primitives(document.container.tree)
        if isinstance(index := _attributes(primitive).get("COLOR_0"), int) and 0 <= index < len(accessors)
    }
    return {
        "generator": asset.text("generator"),
        "version": asset.text("version"),
        "scenes": len(root.entries("scenes")),
        "nodes": len(root.entries("nodes")),
        "meshes": len(root.entries("meshes")),
        "primitives": len(_primitives(document.container.tree)),
        "colour accessors": [
            {
                "accessor": index,
                "type": accessors[index].shape,
                "component": accessors[index].component.name,
                "count": accessors[index].count,
                "sparse": accessors[index].sparse is not None,
            }
            for index in sorted(colours)
        ],
        "materials": len(root.entries("materials")),
        "images": len(root.entries("images")),
        "textures": len(root.entries("textures")),
        "slots": list(present_slots(root)),
        "skins": len(root.entries("skins")),
        "animations": len(root.entries("animations")),
        "extensions used": root.texts("extensionsUsed"),
        "extensions required": root.texts("extensionsRequired"),
    }
