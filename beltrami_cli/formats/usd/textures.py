"""The images that a USD scene shows, the triangles under them, and all of it for conversion."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.errors import InputError
from beltrami_cli.formats import textured_mesh
from beltrami_cli.formats.colours import display_colour
from beltrami_cli.formats.document import NewImages
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.formats.scene import SLOTS, MeshImages, Scene, ShownMap
from beltrami_cli.formats.usd.layers import Layers
from beltrami_cli.surface import records


class Textures:
    """The textures of a scene; paths are of files, or of sets of tiles, and relative to the root layer's folder."""

    def __init__(self, layers: Layers, words: dict[str, Any], arrays: dict[str, Array], name: str) -> None:
        self._layers, self._words, self._arrays, self._name = layers, words, arrays, name
        self._path_of: list[str | None] = []
        self._reasons: dict[int, str] = {}
        for number, use in enumerate(words["uses"]):
            try:
                self._path_of.append(layers.locate(use["file"]))
            except UnfitReferenceError as error:
                self._path_of.append(None)
                self._reasons[number] = str(error)

    def slots(self) -> tuple[records.Slot, ...]:
        return tuple(slot for slot in SLOTS if slot in self._words["slots"])

    def _uses(self, slot: records.Slot) -> list[int]:
        materials = self._words["materials"]
        return [each["uses"][slot] for each in materials if slot in each["uses"]]

    def files(self) -> list[str]:
        """Return all image files that are named, in a slot or elsewhere, each once."""
        paths = dict.fromkeys(path for path in self._path_of if path is not None)
        shown = [file for path in paths for file in self._layers.folder.files(path)]
        return list(dict.fromkeys([*shown, *self.labelled().values()]))

    def missing(self) -> list[str]:
        return [self._words["uses"][number]["file"] for number in self._reasons]

    def labelled(self) -> dict[str, str]:
        """Return every image file by where it is named, in a slot or elsewhere."""
        found: dict[str, str] = {}
        for attribute, file in self._words["images"].items():
            try:
                path = self._layers.locate(file)
            except UnfitReferenceError:
                continue
            tiles = self._layers.folder.tiles.get(path, {})
            found |= {f"{attribute}, tile {tile}": each for tile, each in tiles.items()} or {attribute: path}
        return found

    def attributes(self, path: str, slots: Sequence[records.Slot] | None = None) -> set[str]:
        """Return the attributes that name a path, in some slots or in all and anywhere else."""
        uses = self._words["uses"]
        if slots is None:
            wanted = {use["file"] for use, known in zip(uses, self._path_of, strict=True) if known == path}
            return {name for name, file in self._words["images"].items() if file in wanted}
        numbers = {number for slot in slots for number in self._uses(slot)}
        return {uses[number]["attribute"] for number in numbers if self._path_of[number] == path}

    def replaced(self, images: NewImages) -> textured_mesh.SlotsByPath:
        """Return the slots in which a path, or files of a set of tiles, are replaced by the same new files."""

        def paths_of(slot: records.Slot, file: str) -> list[str]:
            paths = dict.fromkeys(self._path_of[number] for number in self._uses(slot))
            return [path for path in paths if path is not None and file in self._layers.folder.files(path)]

        return textured_mesh.slots_by_path(images, paths_of)

    def kept(self, images: NewImages) -> list[str]:
        """Return the image files that something still names when others are replaced."""
        slots_of: dict[str, list[records.Slot]] = defaultdict(list)
        for (path, _), slots in self.replaced(images).items():
            slots_of[path] += slots
        gone = (
            path for path, slots in slots_of.items() if self.attributes(path, slots) == self.attributes(path)
        )
        replaced = {file for path in gone for file in self._layers.folder.files(path)}
        return [file for file in self.files() if file not in replaced]

    @property
    def scene(self) -> Scene:
        words, arrays = self._words, self._arrays
        if not len(arrays.get("sizes", ())):
            raise InputError(self._name, "it has no polygons, so there is nothing to show a texture")
        if not np.isfinite(arrays["positions"]).all():
            raise InputError(self._name, "some places of its vertices are no finite numbers")
        known, corners = words["materials"], arrays["corners"].astype(np.int32)
        bare = np.full((len(corners), 2), np.nan)
        return Scene(
            name=self._name,
            positions=arrays["positions"],
            corners=corners,
            offsets=np.concatenate([[0], np.cumsum(arrays["sizes"])]),
            material_of=np.where(arrays["material_of"] < 0, len(known), arrays["material_of"]),
            materials=[*(material["name"] for material in known), ""],
            maps=[*({slot: self._map(use) for slot, use in each["uses"].items()} for each in known), {}],
            uv=lambda slot: arrays.get(f"uv {slot}", bare),
            tiles=self._layers.folder.tiles,
            read=self._layers.image,
        )

    def _map(self, number: int) -> ShownMap:
        use = self._words["uses"][number]
        return ShownMap(use["file"], self._path_of[number], self._reasons.get(number, ""), tuple(use["wrap"]))

    def mesh(self, source: str, colours: Float32s | None, left_out: Sequence[str]) -> records.TexturedMesh:
        """Return all triangles with their materials, groups, normals and texture coordinates."""
        groups = tuple(self._words["meshes"]), self._arrays["mesh_of"]
        mesh = self.scene.mesh(self._material, left_out, groups, self._arrays["normals"], source)
        return dataclasses.replace(mesh, colours=None if colours is None else self._by_vertex(colours))

    def _material(
        self, number: int, maps: Mapping[records.Slot, records.MaterialMap], images: MeshImages
    ) -> records.Material:
        """Return a material, whose colours are linear light in USD."""
        if number == len(self._words["materials"]):
            return records.Material()
        known = self._words["materials"][number]
        values = known["values"]
        opacity = values.get("opacity", 1.0)
        mask = values.get("opacityThreshold", 0.0) > 0
        seen_through = known["alpha"] or opacity < 1
        white, has_metal = (1.0, 1.0, 1.0), "metallicRoughness" in maps
        colour, emission = values.get("diffuseColor", [0.18] * 3), values.get("emissiveColor", [0.0] * 3)
        return records.Material(
            name=known["name"],
            maps=maps,
            colour=white if "baseColor" in maps else display_colour(colour),
            emission=white if "emissive" in maps else display_colour(emission),
            opacity=opacity,
            metalness=1.0 if has_metal else values.get("metallic", 0.0),
            roughness=1.0 if has_metal else values.get("roughness", 0.5),
            alpha="mask" if seen_through and mask else "blend" if seen_through else "opaque",
        )

    def _by_vertex(self, colours: Float32s) -> records.VertexColours | None:
        vertex, count = self._arrays["colour_vertex"], len(self._arrays["positions"])
        if len(vertex) != count or len(np.unique(vertex)) != count:
            return None
        ordered = np.empty_like(colours)
        ordered[vertex] = colours
        return records.VertexColours(ordered, "linear", "float32")
