"""USD scenes, as layers or packages, in which vertex colours and images can be replaced."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Float32s, Int32s, Int64s
from beltrami_cli.errors import InputError, NoColoursError, Obstacle
from beltrami_cli.formats.changes import Changes, Naming, PlannedImages, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.fingerprint import Fingerprint, labelled
from beltrami_cli.formats.meshes.scene import Scene, ShownMap
from beltrami_cli.formats.meshes.scene_mesh import textured_mesh
from beltrami_cli.formats.sidecars.model_folder import IGNORED
from beltrami_cli.formats.usd.contents import Count, SceneContents
from beltrami_cli.formats.usd.images import Images
from beltrami_cli.formats.usd.layers import Layers
from beltrami_cli.surface.precision import require_finite, require_single
from beltrami_cli.surface.records import Frame, Material, MeshContents
from beltrami_cli.surface.slots import SLOTS, Slot

_COUNTED: dict[Count, str] = {
    "instanced": "{} mesh(es) are instances of others; each is smoothed once, at its first place",
    "hidden": "{} mesh(es) are invisible, or for proxies and guides, and are left as they are",
    "flat": "{} mesh(es) have one colour, or one for each face, which is left as it is",
    "unfit": "{} mesh(es) have colours that do not fit their points; these are left as they are",
    "animated": "{} mesh(es) have colours that change with time, which are left as they are",
    "no mesh": "{} prim(s) that are not meshes have colours of points, which are left as they are",
    "unread": "{} material(s) are neither a UsdPreviewSurface nor a MaterialX surface whose colour is an image",
    "bare": "{} part(s) have no texture coordinates for a texture",
}
_UNCOLOURED: tuple[Count, ...] = ("uncoloured", "flat", "unfit", "animated")
_REMEDIES: dict[Count, str] = {"unread": "bake their colours into images, or give the vertices colours"}

_VARIANTS_NOTICE = (
    "Variants of another layer have colours of their own; the new ones hold whichever is selected."
)


class UsdDocument(Document):
    """An opened scene."""

    def _open(self, folder: Path | None) -> None:
        self._layers = Layers.of(self.data, self.name, folder, self.access)
        is_package = self._layers.package is not None
        self.format = "usdz" if is_package else Path(self._layers.root).suffix[1:]
        self.forms = ("usdz",) if is_package else ("usd", "usda", "usdc")

    @cached_property
    def _contents(self) -> SceneContents:
        return self._layers.scene()

    @property
    def notices(self) -> tuple[str, ...]:
        unread = (f"{each.cause}{IGNORED}" for each in self._unread_layers())
        return (*unread, *(f"{each.cause}." for each in self._counted_parts()))

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        return (*self._unread_layers(), *self._counted_parts())

    def _unread_layers(self) -> list[Obstacle]:
        unread = self._contents.unread.items()
        return [Obstacle(f"'{path}' {cause}", remedy) for path, (cause, remedy) in unread]

    def _counted_parts(self) -> list[Obstacle]:
        counts = self._contents.counts
        return [
            Obstacle(cause.format(number), _REMEDIES.get(key, ""))
            for key, cause in _COUNTED.items()
            if (number := counts.get(key))
        ]

    @cached_property
    def _images(self) -> Images:
        return Images(self._contents, self._layers, self.name)

    def has_vertex_colours(self) -> bool:
        return bool(self._contents.blocks)

    @cached_property
    def _mesh(self) -> MeshContents:
        if not self.has_vertex_colours():
            cause = "its meshes have no colours of vertices (displayColor)"
            raise NoColoursError(self.name, cause, "give them colours first")
        arrays = self._contents.arrays
        positions, colours = arrays["positions"][arrays["colour_vertex"]], arrays["colours"]
        require_finite(positions, self.name, "the place of vertex")
        require_single(colours, self.name, "the colour of vertex")
        kinds = {block.type for block in self._contents.blocks}
        stored = kinds.pop() if len(kinds) == 1 else "float32"
        polygons = self._coloured_polygons
        return MeshContents(
            positions, *polygons, colours.astype(np.float32), "linear", stored, frame=self.frame
        )

    @cached_property
    def _coloured_polygons(self) -> tuple[Int32s, Int64s]:
        sizes, rows = self._contents.arrays["sizes"], self._contents.arrays["rows"]
        is_coloured = rows[np.cumsum(sizes) - sizes] >= 0
        kept = rows[np.repeat(is_coloured, sizes)].astype(np.int32)
        return kept, np.concatenate([[0], np.cumsum(sizes[is_coloured])])

    @property
    def frame(self) -> Frame:
        up, unit = self._contents.up, self._contents.unit
        return Frame("Z" if up == "Z" else "Y", unit if 0 < unit < np.inf else 1.0)

    def slots(self) -> tuple[Slot, ...]:
        return tuple(slot for slot in SLOTS if slot in self._contents.slots)

    @property
    def _scene(self) -> Scene:
        contents, arrays = self._contents, self._contents.arrays
        if not len(arrays.get("sizes", ())):
            raise InputError(self.name, "it has no polygons, so there is nothing to show a texture")
        require_finite(arrays["positions"], self.name, "the place of vertex")
        materials, corners, images = contents.materials, arrays["corners"].astype(np.int32), self._images
        maps: list[dict[Slot, ShownMap]] = [{} for _ in (*materials, None)]
        for use in contents.uses:
            obstacle = images.obstacles.get(use.file, Obstacle(""))
            path = images.paths.get(use.file)
            tiles = self._layers.folder.tiles_of(path)
            maps[use.material][use.slot] = ShownMap(use.file, path, obstacle, use.wrap, tiles=tiles)
        bare = np.full((len(corners), 2), np.nan)
        return Scene(
            name=self.name,
            positions=arrays["positions"],
            corners=corners,
            offsets=np.concatenate([[0], np.cumsum(arrays["sizes"])]),
            material_of=np.where(arrays["material_of"] < 0, len(materials), arrays["material_of"]),
            materials=[*(inputs.material() for inputs in materials), Material()],
            maps=maps,
            uv=lambda slot: arrays.get("uv" if slot is None else f"uv {slot}", bare),
            read=self._layers.folder.content,
            has_factors=True,
        )

    def hidden_places(self) -> tuple[str, ...]:
        return ("further places of a mesh",) if self._contents.counts.get("instanced") else ()

    def references(self) -> Sequence[str]:
        return [] if self._layers.package is not None else self._images.references()

    def _patched(self, new: Changes, naming: Naming) -> Written:
        colours, form, package = new.colours, new.form or self.format, self._layers.package
        sidecars, renamed = self._images.renamed(new.images, naming)
        if colours is not None and np.array_equal(colours, self._coloured_vertices.colours):
            colours = None
        root: dict[str, bytes] = {}
        if colours is not None or renamed or form != self.format:
            suffix = "" if form == self.format else f".{form}"
            layer, hides = self._layers.edited(self._contents.blocks, colours, renamed, suffix)
            root[self._layers.root] = layer
            notices = (*sidecars.notices, *([_VARIANTS_NOTICE] if hides else []))
            sidecars = dataclasses.replace(sidecars, notices=notices)
        if package is None:
            return dataclasses.replace(sidecars, main=[*root.values()] or [self.data])
        files = {**root, **sidecars.sidecars}
        return Written(package.packed(files) if files else [self.data], notices=sidecars.notices)

    def sidecar_names(self, images: PlannedImages, naming: Naming, **_: object) -> list[str]:
        written = self._images.renamed(images, naming)[0]
        return written.sidecar_names if self._layers.package is None else []

    def contents(self) -> MeshContents:
        mesh, counts, arrays = self._mesh, self._contents.counts, self._contents.arrays
        losses = {
            "materials": self._contents.materials,
            "uncoloured meshes": any(counts.get(key) for key in _UNCOLOURED),
            "texture coordinates": any(
                np.isfinite(arrays[name]).any() for name in arrays if name.startswith("uv")
            ),
            "normals": np.isfinite(arrays["normals"]).any(),
        }
        alpha = arrays["opacity"].clip(0, 1).astype(np.float32) if counts.get("transparent") else None
        left_out = (*(what for what, is_lost in losses.items() if is_lost), *self._omitted())
        return dataclasses.replace(mesh, alpha=alpha, left_out=left_out)

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        contents, arrays = self._contents, self._contents.arrays
        groups = contents.meshes, arrays["mesh_of"]
        mesh = textured_mesh(self._scene, self._omitted(), groups, arrays["normals"])
        return self._with_vertex_colours(dataclasses.replace(mesh, frame=self.frame), colours)

    def _omitted(self) -> list[str]:
        contents = self._contents
        omitted = [f"{kind} prims" for kind in contents.others]
        omitted += ["variants"] if contents.variants else []
        omitted += self.hidden_places()
        omitted += ["further vertex attributes"] if contents.counts.get("further") else []
        omitted += dict.fromkeys(lost for inputs in contents.materials for lost in inputs.lost)
        return [*omitted, *(["node hierarchy"] if len(contents.meshes) > 1 else [])]

    def fingerprint(self) -> Fingerprint:
        parts = {"root layer": self._layers.text(self._contents).encode()}
        parts |= {f"layer {name}": self._layers.data[name] for name in self._layers.others}
        named = self._images.files()
        package = self._layers.package
        if package is not None:
            described = {*named.values(), *package.layers}
            further = [each for each in package.members if each not in described]
            parts |= {f"file {name}": package.read(name) for name in further}
        colours = {"vertex colours": self._coloured_vertices.colours} if self.has_vertex_colours() else {}
        faults = package.faults() if package is not None else ()
        return Fingerprint(parts, colours, labelled(named, self._layers.folder.content), faults)

    def facts(self) -> dict[str, object]:
        contents = self._contents
        return {
            "layers": list(self._layers.data),
            "meshes": len(contents.meshes),
            "polygons": len(self._contents.arrays.get("sizes", ())),
            "coloured meshes": len(contents.blocks),
            "materials": [material.name for material in contents.materials],
            "slots": list(self.slots()),
            "up axis": contents.up,
            "metres per unit": contents.unit,
            "variants": list(contents.variants),
            "other": list(contents.others),
        }
