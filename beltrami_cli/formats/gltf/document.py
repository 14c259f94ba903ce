"""A glTF 2.0 file, text or binary; only vertex colours, their positions and images are replaced."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import Obstacle
from beltrami_cli.formats.changes import Changes, Naming, PlannedImages, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.fingerprint import Fingerprint
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.buffers import Buffers
from beltrami_cli.formats.gltf.container import read_container
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.entries import Tree, require_structure
from beltrami_cli.formats.gltf.fingerprint import fingerprint
from beltrami_cli.formats.gltf.images import Images
from beltrami_cli.formats.gltf.materials import present_slots
from beltrami_cli.formats.gltf.new_attributes import move, put_dummies, recolour, require_movable
from beltrami_cli.formats.gltf.new_images import show_images
from beltrami_cli.formats.gltf.nodes import placements
from beltrami_cli.formats.gltf.output import place_files, write_files
from beltrami_cli.formats.gltf.primitives import Meshes, read_meshes
from beltrami_cli.formats.gltf.references import objects, primitives_of
from beltrami_cli.formats.gltf.textured_mesh import read_textured_mesh
from beltrami_cli.formats.gltf.textured_surface import read_textured_surface
from beltrami_cli.formats.gltf.uris import SidecarFiles
from beltrami_cli.formats.gltf.vertex_colours import ColouredBlocks
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.surface.records import ColouredVertices, MeshContents, Slot, TexturedSurface

# Of `_omitted`, the losses of conversions with textures.
_NOT_TEXTURED = ("skins", "animations", "cameras", "morph targets")
_MARK_NOTICE = "The JSON starts with a byte order mark, which glTF does not allow; it is kept."


class GltfDocument(Document):
    """An opened glTF file, in either form."""

    forms = ("glb", "gltf", "vrm")

    def _open(self, folder: Path | None) -> None:
        files = ModelFolder(folder, self.access)
        self._container = read_container(self.data, self.name)
        self.format = self._container.kind
        self._root = self._container.root
        require_structure(self._root)
        self._accessors = Accessors(self._root, Buffers(self._container, files))
        self._places = placements(self._root)
        self._images = Images(self._root, self._accessors, files)
        self._files = SidecarFiles(self._root, files)

    @property
    def notices(self) -> tuple[str, ...]:
        mark = [_MARK_NOTICE] if self._container.has_bom else []
        return (*mark, *(f"{each.cause}." for each in self.obstacles))

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        return tuple(self._files.obstacles)

    @cached_property
    def _meshes(self) -> Meshes:
        return read_meshes(self._root, self._accessors)

    @cached_property
    def _blocks(self) -> ColouredBlocks:
        return ColouredBlocks(self.name, self._meshes, self._places)

    @cached_property
    def _coloured_vertices(self) -> ColouredVertices:
        return self._blocks.vertices()

    def has_vertex_colours(self) -> bool:
        primitives = primitives_of(self._container.tree)
        return any("COLOR_0" in primitive.get("attributes", {}) for _, primitive in primitives)

    def slots(self) -> tuple[Slot, ...]:
        return present_slots(self._root)

    def _gathered(self, slot: Slot) -> TexturedSurface:
        return read_textured_surface(self._root, self._meshes, self._places, self._images, slot)

    def hidden_places(self) -> tuple[str, ...]:
        shown = [str(node["mesh"]) for node in objects(self._container.tree.get("nodes")) if "mesh" in node]
        return ("further places of a mesh",) if len({*shown}) < len(shown) else ()

    def attributes(self) -> tuple[str, ...]:
        return self._blocks.attribute_names()

    def _attribute(self, name: str) -> Float64s:
        if name == "normal" and (normals := self._blocks.normals()) is not None:
            return normals.astype(np.float64)
        return self._blocks.attribute(name)

    def require_movable(self) -> None:
        require_movable(self._blocks.blocks)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        edit = Edit(self._container, self._accessors)
        if new.colours is not None:
            recolour(edit, self._blocks.blocks, self.coloured_vertices().colours, new.colours)
        if new.places is not None:
            move(edit, self._blocks.blocks, self.coloured_vertices().positions, new.places)
        show_images(edit, self._images, new.images)
        return write_files(edit, naming, new.form or self.format, self._files)

    def sidecar_names(
        self, images: PlannedImages, naming: Naming, *, colours: bool, places: bool = False, form: str | None = None
    ) -> list[str]:  # fmt: skip
        form = form or self.format
        if form != "gltf" and not (self.format == "glb" and self._files.any):
            return []
        edit = Edit(self._container, self._accessors)
        if colours:
            put_dummies(edit, self._blocks.blocks, places=places)
        show_images(edit, self._images, images)
        edit.finish()
        return place_files(edit, naming, form, self._files).written().sidecar_names

    def references(self) -> Sequence[str]:
        return [*self._files.present]

    def contents(self) -> MeshContents:
        shown = self.coloured_vertices()
        return MeshContents(
            positions=shown.positions,
            corners=shown.faces.reshape(-1),
            offsets=np.arange(0, 3 * len(shown.faces) + 1, 3, dtype=np.int64),
            colours=shown.colours,
            encoding="linear",
            stored=shown.stored,
            alpha=self._blocks.opacity(),
            normals=self._blocks.normals(),
            left_out=(*_omitted(self._container.tree), *self._extensions(), *self.hidden_places()),
            notices=shown.notices,
        )

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        stored, by_primitive, notices = "float32", dict[tuple[int, int], Float32s](), tuple[str, ...]()
        if self.has_vertex_colours():
            shown = self.coloured_vertices()
            stored, notices = shown.stored, shown.notices
            by_primitive = self._blocks.by_primitive(shown.colours if colours is None else colours)
        mesh = read_textured_mesh(self._root, self._meshes, self._images, by_primitive, stored)
        losses = [what for what in _omitted(self._container.tree) if what in _NOT_TEXTURED]
        losses += self._extensions()
        if any(node.get("children") for node in objects(self._container.tree.get("nodes"))):
            losses.append("node hierarchy")
        return dataclasses.replace(mesh, left_out=(*mesh.left_out, *losses), notices=notices)

    def _extensions(self) -> list[str]:
        """Return the extensions of the file and of its nodes, such as avatars and instances."""
        parts = [self._root, *self._root.entries("nodes")]
        return sorted({name for part in parts for name in part.entry("extensions").value})

    def fingerprint(self) -> Fingerprint:
        parts, images = fingerprint(self._container, self._accessors, self._images)
        colours: dict[str, Float32s] = {}
        if self.has_vertex_colours():
            colours["vertex colours"] = self.coloured_vertices().colours
            opacity = [
                stored[:, 3].tobytes() for stored in self._blocks.stored_colours if stored.shape[1] == 4
            ]
            parts["opacity of vertex colours"] = b"".join(opacity)
        return Fingerprint(parts, colours, images)

    def facts(self) -> dict[str, object]:
        root, asset = self._root, self._root.entry("asset")
        primitives = [primitive for _, primitive in primitives_of(self._container.tree)]
        named = {primitive.get("attributes", {}).get("COLOR_0", -1) for primitive in primitives}
        indices = (index for index in sorted(named) if 0 <= index < len(self._accessors))
        return {
            "generator": asset.text("generator"),
            "version": asset.text("version"),
            "scenes": len(root.entries("scenes")),
            "nodes": len(root.entries("nodes")),
            "meshes": len(root.entries("meshes")),
            "primitives": len(primitives),
            "colour accessors": [
                {
                    "accessor": index,
                    "type": accessor.shape,
                    "component": accessor.component.name,
                    "count": accessor.count,
                    "sparse": accessor.sparse is not None,
                }
                for index, accessor in ((index, self._accessors[index]) for index in indices)
            ],
            "materials": len(root.entries("materials")),
            "images": len(self._images),
            "textures": len(self._images.textures),
            "slots": list(self.slots()),
            "skins": len(root.entries("skins")),
            "animations": len(root.entries("animations")),
            "extensions used": self._container.tree.get("extensionsUsed", []),
            "extensions required": self._container.tree.get("extensionsRequired", []),
        }


def _omitted(tree: Tree) -> list[str]:
    primitives = [primitive for _, primitive in primitives_of(tree)]
    sets = [primitive.get("attributes", {}) for primitive in primitives]
    attributes, nodes = {key for each in sets for key in each}, objects(tree.get("nodes"))
    placed = ("children", "matrix", "translation", "rotation", "scale")
    losses = {key: tree.get(key) for key in ("materials", "textures", "skins", "animations", "cameras")} | {
        "morph targets": any(primitive.get("targets") for primitive in primitives),
        "uncoloured meshes": any("COLOR_0" not in each for each in sets),
        "texture coordinates": any(key.startswith("TEXCOORD_") for key in attributes),
        "further vertex attributes": any(
            key in ("TANGENT", "COLOR_1") or key.startswith("_") for key in attributes
        ),
        "normals, which some parts lack": len({"NORMAL" in each for each in sets if "COLOR_0" in each}) > 1,
        "lines": any(primitive.get("mode") in (1, 2, 3) for primitive in primitives),
        "node hierarchy": len(nodes) > 1 or any(key in node for node in nodes for key in placed),
    }
    return [what for what, is_lost in losses.items() if is_lost]
