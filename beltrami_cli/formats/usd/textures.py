"""The images that a USD scene shows, the triangles under them, and all of it for conversion."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats import textured_mesh
from beltrami_cli.formats.colours import display_colour
from beltrami_cli.formats.document import NewImages
from beltrami_cli.formats.model_folder import LEFT_ALONE, UnfitReferenceError
from beltrami_cli.formats.usd.layers import Layers
from beltrami_cli.surface import records, tiling
from beltrami_cli.surface.geometry import triangulate_corners

_ALL: tuple[records.Slot, ...] = get_args(records.Slot)


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
                self._reasons[number] = f"'{use['file']}' {error}"

    def slots(self) -> tuple[records.Slot, ...]:
        return tuple(slot for slot in _ALL if slot in self._words["slots"])

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

    def surface(self, slot: records.Slot) -> tuple[records.TexturedSurface, list[str]]:
        """Return all triangles and the images of a slot, and notices."""
        positions, cut, polygon = self._triangles
        shown = textured_mesh.SlotImages(slot)
        texture_of_use = np.full(len(self._path_of) + 1, -1)
        for number in dict.fromkeys(self._uses(slot)):
            use, path = self._words["uses"][number], self._path_of[number]
            if path is not None:
                known = path, self._layers.folder.tiles, use["material"], tuple(use["wrap"])
                texture_of_use[number] = shown.show_files(*known, self._layers.image)
            else:
                shown.miss(self._reasons[number], use["material"])
        texture_of = texture_of_use[self._arrays[f"use {slot}"][polygon]]
        uv = self._arrays[f"uv {slot}"][cut]
        texture_of[~np.isfinite(uv).all(axis=(1, 2))] = -1
        if (texture_of == -1).all():
            raise shown.refusal(self._name, is_bare=len(shown) > 0)
        uv = np.where((texture_of == -1)[:, None, None], 0.0, uv)
        uv[..., 1] = 1 - uv[..., 1]
        faces = self._arrays["corners"][cut].astype(np.int32)
        surface = records.TexturedSurface(positions, faces, uv, texture_of.astype(np.int32), shown.textures())
        if shown.sets:
            surface = tiling.on_tiles(surface, shown.sets, self._name)
        return surface, shown.notices()

    @property
    def _triangles(self) -> tuple[Float64s, Int64s, Int64s]:
        """Positions, and for each triangle its corners among the polygons' corners, and its polygon."""
        if not len(self._arrays.get("sizes", ())):
            raise InputError(self._name, "it has no polygons, so there is nothing to show a texture")
        positions = self._arrays["positions"]
        if not np.isfinite(positions).all():
            raise InputError(self._name, "some places of its vertices are no finite numbers")
        corners = self._arrays["corners"].astype(np.int32)
        offsets = np.concatenate([[0], np.cumsum(self._arrays["sizes"])])
        cut, polygon = triangulate_corners(positions, corners, offsets)
        return positions, cut.astype(np.int64), polygon

    def mesh(self, source: str, colours: Float32s | None, left_out: Sequence[str]) -> records.TexturedMesh:
        """Return all triangles with their materials, groups, normals and texture coordinates."""
        positions, cut, polygon = self._triangles
        lost = [*left_out, *([textured_mesh.POLYGONS_CUT] if (self._arrays["sizes"] > 3).any() else [])]
        numbers, known = self._arrays["material_of"][polygon], self._words["materials"]
        numbers = np.where(numbers < 0, len(known), numbers)
        uv, elsewhere = np.full((len(cut), 3, 2), np.nan), set[tuple[int, records.Slot]]()
        for slot in self.slots():
            own = self._arrays[f"uv {slot}"][cut]
            fresh = np.isnan(uv).any(axis=(1, 2))
            differs = ~fresh & ~np.isnan(own).any(axis=(1, 2)) & (own != uv).any(axis=(1, 2))
            elsewhere |= {(number, slot) for number in numbers[differs].tolist()}
            uv[fresh] = own[fresh]
        uv = textured_mesh.usable_coordinates(uv)
        uv[..., 1] = 1 - uv[..., 1]
        lost += [f"{slot} maps that are placed otherwise than the base colour" for _, slot in elsewhere]
        images = textured_mesh.MeshImages()
        materials = []
        for number, each in enumerate(known):
            uses = {slot: use for slot, use in each["uses"].items() if (number, slot) not in elsewhere}
            materials.append(self._material({**each, "uses": uses}, images, lost))
        materials.append(records.Material())
        shown, material_of = textured_mesh.shown_materials(materials, numbers)
        normals = self._arrays["normals"][cut].astype(np.float32)
        mesh = records.TexturedMesh(
            positions=positions,
            faces=self._arrays["corners"][cut].astype(np.int32),
            uv=uv,
            materials=shown,
            images=tuple(images.images),
            source=source,
            material_of=material_of,
            groups=tuple(self._words["meshes"]),
            group_of=self._arrays["mesh_of"][polygon].astype(np.int32),
            normals=None if np.isnan(normals).all() else normals,
            colours=None if colours is None else self._by_vertex(colours),
            left_out=tuple(lost),
        )
        return textured_mesh.on_tiles(mesh, images.sets)

    def _material(
        self, known: dict[str, Any], images: textured_mesh.MeshImages, lost: list[str]
    ) -> records.Material:
        """Return a material, whose colours are linear light in USD; its images, or their lack, are noted."""
        maps: dict[records.Slot, records.MaterialMap] = {}
        for slot, use in known["uses"].items():
            path = self._path_of[use]
            if path is None:
                lost.append(f"the {slot} map '{self._words['uses'][use]['file']}'{LEFT_ALONE[:-1]}")
            else:
                image = images.take_file(path, self._layers.folder.tiles, self._layers.image)
                maps[slot] = records.MaterialMap(image, tuple(self._words["uses"][use]["wrap"]))
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
