"""USD scenes, as layers or as a package; only vertex colours and images are replaced."""

from __future__ import annotations

import dataclasses
import posixpath
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int32s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError, UsageError
from beltrami_cli.formats.colours import display_colour
from beltrami_cli.formats.document import (
    Changes,
    Document,
    Fingerprint,
    Naming,
    NewImages,
    PlannedImages,
    Written,
)
from beltrami_cli.formats.image.picture import format_of, format_of_suffix
from beltrami_cli.formats.model_folder import LEFT_ALONE, NewFiles, UnfitReferenceError
from beltrami_cli.formats.textured_mesh import (
    SLOTS,
    MeshImages,
    Scene,
    ShownMap,
    SlotsByPath,
    common_suffix,
    new_files,
    slots_by_path,
)
from beltrami_cli.formats.usd.layers import IMAGES, Layers
from beltrami_cli.surface.records import (
    Frame,
    ImageFile,
    Material,
    MaterialMap,
    MeshContents,
    Slot,
    Texture,
    TexturedMesh,
    TexturedSurface,
    VertexColours,
)

_COUNTS = {
    "instanced": "{} mesh(es) are instances of others; each is smoothed once, at its first place.",
    "hidden": "{} mesh(es) are invisible, or for proxies and guides, and are left as they are.",
    "flat": "{} mesh(es) have one colour, or one for each face, which is left as it is.",
    "unfit": "{} mesh(es) have colours that do not fit their points; these are left as they are.",
    "animated": "{} mesh(es) have colours that change with time, which are left as they are.",
    "unread": "{} material(s) are no UsdPreviewSurface, and no MaterialX surface whose colour is an image.",
    "bare": "{} part(s) have no texture coordinates for a texture.",
}


class _Textures:
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

    def slots(self) -> tuple[Slot, ...]:
        return tuple(slot for slot in SLOTS if slot in self._words["slots"])

    def _uses(self, slot: Slot) -> list[int]:
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

    def attributes(self, path: str, slots: Sequence[Slot] | None = None) -> set[str]:
        """Return the attributes that name a path, in some slots or in all and anywhere else."""
        uses = self._words["uses"]
        if slots is None:
            wanted = {use["file"] for use, known in zip(uses, self._path_of, strict=True) if known == path}
            return {name for name, file in self._words["images"].items() if file in wanted}
        numbers = {number for slot in slots for number in self._uses(slot)}
        return {uses[number]["attribute"] for number in numbers if self._path_of[number] == path}

    def replaced(self, images: NewImages) -> SlotsByPath:
        """Return the slots in which a path, or files of a set of tiles, are replaced by the same new files."""

        def paths_of(slot: Slot, file: str) -> list[str]:
            paths = dict.fromkeys(self._path_of[number] for number in self._uses(slot))
            return [path for path in paths if path is not None and file in self._layers.folder.files(path)]

        return slots_by_path(images, paths_of)

    def kept(self, images: NewImages) -> list[str]:
        """Return the image files that something still names when others are replaced."""
        slots_of: dict[str, list[Slot]] = defaultdict(list)
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

    def mesh(self, source: str, colours: Float32s | None, left_out: Sequence[str]) -> TexturedMesh:
        """Return all triangles with their materials, groups, normals and texture coordinates."""
        groups = tuple(self._words["meshes"]), self._arrays["mesh_of"]
        mesh = self.scene.mesh(self._material, left_out, groups, self._arrays["normals"], source)
        return dataclasses.replace(mesh, colours=None if colours is None else self._by_vertex(colours))

    def _material(self, number: int, maps: Mapping[Slot, MaterialMap], images: MeshImages) -> Material:
        """Return a material, whose colours are linear light in USD."""
        if number == len(self._words["materials"]):
            return Material()
        known = self._words["materials"][number]
        values = known["values"]
        opacity = values.get("opacity", 1.0)
        mask = values.get("opacityThreshold", 0.0) > 0
        seen_through = known["alpha"] or opacity < 1
        white, has_metal = (1.0, 1.0, 1.0), "metallicRoughness" in maps
        colour, emission = values.get("diffuseColor", [0.18] * 3), values.get("emissiveColor", [0.0] * 3)
        return Material(
            name=known["name"],
            maps=maps,
            colour=white if "baseColor" in maps else display_colour(colour),
            emission=white if "emissive" in maps else display_colour(emission),
            opacity=opacity,
            metalness=1.0 if has_metal else values.get("metallic", 0.0),
            roughness=1.0 if has_metal else values.get("roughness", 0.5),
            alpha="mask" if seen_through and mask else "blend" if seen_through else "opaque",
        )

    def _by_vertex(self, colours: Float32s) -> VertexColours | None:
        vertex, count = self._arrays["colour_vertex"], len(self._arrays["positions"])
        if len(vertex) != count or len(np.unique(vertex)) != count:
            return None
        ordered = np.empty_like(colours)
        ordered[vertex] = colours
        return VertexColours(ordered, "linear", "float32")


class UsdDocument(Document):
    """An opened scene."""

    format: str  # type: ignore[misc]  # one class reads all forms, so only an instance knows its format

    def _open(self, folder: Path | None) -> None:
        self._compared = False  # whether the scene is read for that
        self._layers = Layers.of(self.data, self.name, folder, self.access)
        is_package = self._layers.package is not None
        self.format = "usdz" if is_package else Path(self._layers.root).suffix[1:]
        self.forms = ("usdz",) if is_package else ("usd", "usda", "usdc")

    @cached_property
    def _scene(self) -> tuple[dict[str, Any], dict[str, Array]]:
        words, arrays = self._layers.scene(text=self._compared)
        counts = words["counts"]
        self.notices += [f"'{path}' {why}{LEFT_ALONE}" for path, why in self._layers.reasons.items()]
        self.notices += [sentence.format(n) for key, sentence in _COUNTS.items() if (n := counts.get(key))]
        return words, arrays

    @property
    def _words(self) -> dict[str, Any]:
        return self._scene[0]

    @property
    def _arrays(self) -> dict[str, Array]:
        return self._scene[1]

    @cached_property
    def _textures(self) -> _Textures:
        return _Textures(self._layers, *self._scene, self.name)

    def has_vertex_colours(self) -> bool:
        return bool(self._words["blocks"])

    @cached_property
    def _mesh(self) -> MeshContents:
        if not self.has_vertex_colours():
            cause = "its meshes have no colours of vertices (displayColor)"
            raise UnpaintedError(self.name, cause, "paint them first")
        positions = self._arrays["positions"][self._arrays["colour_vertex"]]
        colours = self._arrays["colours"].astype(np.float32)
        for values, what in ((positions, "places"), (colours, "colours")):
            if not np.isfinite(values).all():
                raise InputError(self.name, f"some {what} of its vertices are no finite numbers")
        kinds = {block["type"] for block in self._words["blocks"]}
        stored = kinds.pop() if len(kinds) == 1 else "float32"
        polygons = self._coloured_polygons
        return MeshContents(positions, *polygons, colours, "linear", stored, frame=self.frame)

    @cached_property
    def _coloured_polygons(self) -> tuple[Int32s, Int64s]:
        sizes, rows = self._arrays["sizes"], self._arrays["rows"]
        is_coloured = rows[np.cumsum(sizes) - sizes] >= 0
        kept = rows[np.repeat(is_coloured, sizes)].astype(np.int32)
        return kept, np.concatenate([[0], np.cumsum(sizes[is_coloured])])

    @property
    def frame(self) -> Frame:
        return Frame(self._words["up"], self._words["unit"])

    def slots(self) -> tuple[Slot, ...]:
        return self._textures.slots()

    def _gathered(self, slot: Slot) -> TexturedSurface:
        surface, notices = self._textures.scene.surface(slot)
        self.notices += notices
        return surface

    def references(self) -> Sequence[str]:
        if self._layers.package is not None:
            return []
        images = self._textures.files()  # which reads the scene, and so finds the layers
        return [*self._other_layers(), *images]

    def _other_layers(self) -> list[str]:
        return [layer for layer in self._layers.contents if layer != self._layers.root]

    def _patched(self, new: Changes, naming: Naming) -> Written:
        colours, form, package = new.colours, new.form or self.format, self._layers.package
        sidecars, renamed = self._new_images(new.images, naming)
        if colours is not None and np.array_equal(colours, self._painted.colours):
            colours = None
        root = {}
        if colours is not None or renamed or form != self.format:
            same = form == self.format
            suffix = Path(self._layers.root).suffix if same else f".{form}"
            blocks, arrays = ([], {}) if colours is None else (self._words["blocks"], {"colours": colours})
            order = {"task": "edit", "blocks": blocks, "files": renamed, "suffix": suffix, "same": same}
            root = {self._layers.root: self._layers.ask(order, arrays)[1]["layer"].tobytes()}
        if package is None:
            return dataclasses.replace(sidecars, main=[*root.values()] or [self.data])
        files = {**root, **sidecars.sidecars}
        return Written(package.packed(files) if files else [self.data])

    def sidecar_names(self, images: PlannedImages, naming: Naming, **_: object) -> list[str]:
        written = self._new_images(images, naming)[0]
        return written.sidecar_names if self._layers.package is None else []

    def _new_images(self, images: NewImages, naming: Naming) -> tuple[Written, dict[str, str]]:
        """Return the new files of the root layer or package, and the attributes with the new names."""
        shown, kept = self._textures, list[str]()
        if naming.copies and self._layers.package is None:
            kept = [*self._other_layers(), *shown.kept(images)]
            taken = next((file for file in kept if naming.is_taken(file)), None)
            if taken is not None:  # other layers name the files that are copied
                cause = f"there is another '{taken}' in OUTPUT's folder, and one of its files needs that name"
                raise InputError(self.name, cause, "choose an empty folder")
        present = self._layers.package.members if self._layers.package else self.references()
        names = NewFiles(naming, self.name, present, [*shown.missing(), *kept])
        names.copied |= {file: file for file in kept}
        renamed: dict[str, str] = {}
        for (path, changed), slots in shown.replaced(images).items():
            attributes = shown.attributes(path, slots)
            is_replaced = attributes == shown.attributes(path)
            new = self._new_path(path, dict(changed), names, is_replaced=is_replaced)
            own = new_files(path, new, self._layers.folder.tiles)
            names.sidecars |= {own.pop(file): image.content for file, image in changed}
            names.copied |= {file: old for old, file in own.items() if file != old}
            if new != path:
                start = posixpath.dirname(self._layers.root) or "."
                renamed |= dict.fromkeys(attributes, "./" + posixpath.relpath(new, start))
        if self._layers.package is not None:
            names.sidecars |= {new: self._layers.image(old) for new, old in names.copied.items()}
        return names.written(), renamed

    def _new_path(
        self, path: str, new: Mapping[str, ImageFile], names: NewFiles, *, is_replaced: bool
    ) -> str:
        """Return where an image or a set of tiles is written: in a package in its own place, if its type stays."""
        suffixes = {image.suffix for image in new.values()}
        known = {format_of(self._layers.image(file), file) for file in new}
        stays = {format_of_suffix(suffix) for suffix in suffixes} == known
        if self._layers.package is not None and is_replaced and stays:
            return path
        unfit = suffixes - {*IMAGES}
        if self._layers.package is not None and unfit and not stays:
            raise UsageError(f"{self.name}: packages hold no {min(unfit)} images; choose {', '.join(IMAGES)}")
        suffix = common_suffix(suffixes)
        tiles = self._layers.folder.tiles.get(path, ())
        return names.image(path, None if stays else suffix, is_replaced=is_replaced, tiles=tiles)

    def contents(self) -> MeshContents:
        mesh, is_opaque = self._mesh, not self._words["counts"].get("transparent")
        return dataclasses.replace(
            mesh,
            alpha=None if is_opaque else self._arrays["opacity"].clip(0, 1).astype(np.float32),
            left_out=(*(["materials"] if self._words["materials"] else []), *self._left_out()),
        )

    def textured_mesh(self, colours: Float32s | None = None) -> TexturedMesh:
        values = self._painted.colours if colours is None and self.has_vertex_colours() else colours
        mesh = self._textures.mesh(PurePath(self.name).stem, values, self._left_out())
        return dataclasses.replace(mesh, frame=self.frame)

    def _left_out(self) -> list[str]:
        words = self._words
        others = [f"{kind} prims" for kind in words["others"]]
        others += ["variants"] if words["variants"] else []
        return [*others, *(["node hierarchy"] if len(words["meshes"]) > 1 else [])]

    def fingerprint(self) -> Fingerprint:
        self._compared = True
        words = self._words
        if "text" not in words:  # the scene was read for something else before
            words = self._layers.scene(text=True)[0]
        parts = {"root layer": words["text"].encode()}
        parts |= {f"layer {name}": self._layers.contents[name] for name in self._other_layers()}
        named = self._textures.labelled()
        package = self._layers.package
        if package is not None:
            known = {*named.values(), *package.layers}
            others = [each for each in package.members if each not in known]
            parts |= {f"file {name}": package.read(name) for name in others}
        colours = {"vertex colours": self._painted.colours} if self.has_vertex_colours() else {}
        read = self._layers.image
        images = {
            at: Texture(file, posixpath.basename(file), partial(read, file)) for at, file in named.items()
        }
        return Fingerprint(parts, colours, images, package.faults() if package is not None else ())

    def facts(self) -> dict[str, object]:
        words = self._words
        return {
            "layers": list(self._layers.contents),
            "meshes": len(words["meshes"]),
            "polygons": len(self._arrays.get("sizes", ())),
            "coloured meshes": len(words["blocks"]),
            "materials": [material["name"] for material in words["materials"]],
            "slots": list(self.slots()),
            "up axis": words["up"],
            "metres per unit": words["unit"],
            "variants": words["variants"],
            "other": words["others"],
        }
