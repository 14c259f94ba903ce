"""USD scenes, as layers or as a package; only vertex colours and images are replaced."""

from __future__ import annotations

import dataclasses
import posixpath
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int32s, Int64s
from beltrami_cli.errors import InputError, Obstacle, UnpaintedError, UsageError
from beltrami_cli.formats.changes import Changes, Naming, NewImages, PlannedImages, Written
from beltrami_cli.formats.colours import display_colour
from beltrami_cli.formats.comparison import Fingerprint, labelled
from beltrami_cli.formats.conversion import with_vertex_colours
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.file_formats import format_of, format_of_suffix
from beltrami_cli.formats.model_folder import LEFT_ALONE, UnfitReferenceError
from beltrami_cli.formats.new_files import NewFiles, SlotsByPath, common_suffix, new_files, slots_by_path
from beltrami_cli.formats.scene import SLOTS, Scene, ShownMap
from beltrami_cli.formats.usd.layers import IMAGES, Layers
from beltrami_cli.surface.records import (
    AlphaMode,
    Frame,
    ImageFile,
    Material,
    MeshContents,
    Slot,
    require_finite,
    require_single,
)

_COUNTS = {
    "instanced": "{} mesh(es) are instances of others; each is smoothed once, at its first place",
    "hidden": "{} mesh(es) are invisible, or for proxies and guides, and are left as they are",
    "flat": "{} mesh(es) have one colour, or one for each face, which is left as it is",
    "unfit": "{} mesh(es) have colours that do not fit their points; these are left as they are",
    "animated": "{} mesh(es) have colours that change with time, which are left as they are",
    "no mesh": "{} prim(s) that are no meshes have colours of points, which are left as they are",
    "unread": "{} material(s) are no UsdPreviewSurface, and no MaterialX surface whose colour is an image",
    "bare": "{} part(s) have no texture coordinates for a texture",
}
_REMEDIES = {"unread": "bake their colours into images, or paint the vertices"}

_HIDES = "Variants of another layer have colours of their own; the new ones hold whichever is selected."


def _material(known: dict[str, Any]) -> Material:
    """Return a material without its maps, whose colours are linear light in USD."""
    values = known["values"]
    opacity, cutoff = values.get("opacity", 1.0), values.get("opacityThreshold", 0.0)
    seen_through = known["alpha"] or opacity < 1
    alpha: AlphaMode = "mask" if seen_through and cutoff > 0 else "blend" if seen_through else "opaque"
    return Material(
        name=known["name"],
        colour=display_colour(values.get("diffuseColor", [0.18] * 3)),
        emission=display_colour(values.get("emissiveColor", [0.0] * 3)),
        opacity=_within(opacity),
        metalness=_within(values.get("metallic", 0.0)),
        roughness=_within(values.get("roughness", 0.5)),
        alpha=alpha,
        cutoff=cutoff if alpha == "mask" else Material.cutoff,
    )


def _within(number: float) -> float:
    return min(max(number, 0.0), 1.0)


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
    def _read(self) -> tuple[dict[str, Any], dict[str, Array]]:
        words, arrays = self._layers.scene(text=self._compared)
        counts = words["counts"]
        for path, (cause, remedy) in self._layers.obstacles.items():
            self.obstacles.append(Obstacle(f"'{path}' {cause}", remedy))
            self.notices.append(f"'{path}' {cause}{LEFT_ALONE}")
        for key, cause in _COUNTS.items():
            if number := counts.get(key):
                self.obstacles.append(Obstacle(cause.format(number), _REMEDIES.get(key, "")))
                self.notices.append(f"{cause.format(number)}.")
        return words, arrays

    @property
    def _words(self) -> dict[str, Any]:
        return self._read[0]

    @property
    def _arrays(self) -> dict[str, Array]:
        return self._read[1]

    @cached_property
    def _located(self) -> tuple[dict[str, str], dict[str, Obstacle]]:
        """Paths of images, or of sets of tiles, by their names in the scene; and why others are not read."""
        paths, obstacles = dict[str, str](), dict[str, Obstacle]()
        shown = (use["file"] for use in self._words["uses"])
        for file in dict.fromkeys([*shown, *self._words["images"].values()]):
            try:
                paths[file] = self._layers.locate(file)
            except UnfitReferenceError as error:
                obstacles[file] = error.obstacle
        return paths, obstacles

    def _image_files(self) -> dict[str, str]:
        """Return every image file by where it is named, in a slot or elsewhere."""
        found: dict[str, str] = {}
        for attribute, file in self._words["images"].items():
            path = self._located[0].get(file)
            tiles = self._layers.folder.tiles.get(path or "", {})
            found |= {f"{attribute}, tile {tile}": each for tile, each in tiles.items()}
            found |= {attribute: path} if path is not None and not tiles else {}
        return found

    def _attributes(self, path: str, slots: Sequence[Slot] | None = None) -> set[str]:
        """Return the attributes that name a path, in some slots or anywhere."""
        paths = self._located[0]
        if slots is None:
            return {name for name, file in self._words["images"].items() if paths.get(file) == path}
        shown = [use for use in self._words["uses"] if use["slot"] in slots]
        return {use["attribute"] for use in shown if paths.get(use["file"]) == path}

    def _replaced(self, images: NewImages) -> SlotsByPath:
        """Return the slots in which a path, or files of a set of tiles, are replaced by the same new files."""

        def paths_of(slot: Slot, file: str) -> list[str]:
            shown = [use["file"] for use in self._words["uses"] if use["slot"] == slot]
            paths = dict.fromkeys(self._located[0][name] for name in shown if name in self._located[0])
            return [path for path in paths if file in self._layers.folder.files(path)]

        return slots_by_path(images, paths_of)

    def _kept(self, images: NewImages) -> list[str]:
        """Return the image files that something still names when others are replaced."""
        slots_of: dict[str, list[Slot]] = defaultdict(list)
        for (path, _), slots in self._replaced(images).items():
            slots_of[path] += slots
        gone = [
            path
            for path, slots in slots_of.items()
            if self._attributes(path, slots) == self._attributes(path)
        ]
        replaced = {file for path in gone for file in self._layers.folder.files(path)}
        return [file for file in dict.fromkeys(self._image_files().values()) if file not in replaced]

    def has_vertex_colours(self) -> bool:
        return bool(self._words["blocks"])

    @cached_property
    def _mesh(self) -> MeshContents:
        if not self.has_vertex_colours():
            cause = "its meshes have no colours of vertices (displayColor)"
            raise UnpaintedError(self.name, cause, "paint them first")
        positions = self._arrays["positions"][self._arrays["colour_vertex"]]
        colours = self._arrays["colours"]
        require_finite(positions, self.name, "the place of vertex")
        require_single(colours, self.name, "the colour of vertex")
        kinds = {block["type"] for block in self._words["blocks"]}
        stored = kinds.pop() if len(kinds) == 1 else "float32"
        polygons = self._coloured_polygons
        return MeshContents(
            positions, *polygons, colours.astype(np.float32), "linear", stored, frame=self.frame
        )

    @cached_property
    def _coloured_polygons(self) -> tuple[Int32s, Int64s]:
        sizes, rows = self._arrays["sizes"], self._arrays["rows"]
        is_coloured = rows[np.cumsum(sizes) - sizes] >= 0
        kept = rows[np.repeat(is_coloured, sizes)].astype(np.int32)
        return kept, np.concatenate([[0], np.cumsum(sizes[is_coloured])])

    @property
    def frame(self) -> Frame:
        up, unit = self._words["up"], self._words["unit"]
        return Frame("Z" if up == "Z" else "Y", unit if 0 < unit < np.inf else 1.0)

    def slots(self) -> tuple[Slot, ...]:
        return tuple(slot for slot in SLOTS if slot in self._words["slots"])

    @property
    def _scene(self) -> Scene:
        words, arrays = self._words, self._arrays
        if not len(arrays.get("sizes", ())):
            raise InputError(self.name, "it has no polygons, so there is nothing to show a texture")
        require_finite(arrays["positions"], self.name, "the place of vertex")
        known, corners, (paths, obstacles) = (
            words["materials"],
            arrays["corners"].astype(np.int32),
            self._located,
        )
        maps: list[dict[Slot, ShownMap]] = [{} for _ in (*known, None)]
        for use in words["uses"]:
            file, wrap = use["file"], tuple(use["wrap"])
            shown = ShownMap(file, paths.get(file), obstacles.get(file, Obstacle("")), wrap)
            maps[use["material"]][use["slot"]] = shown
        bare = np.full((len(corners), 2), np.nan)
        return Scene(
            name=self.name,
            positions=arrays["positions"],
            corners=corners,
            offsets=np.concatenate([[0], np.cumsum(arrays["sizes"])]),
            material_of=np.where(arrays["material_of"] < 0, len(known), arrays["material_of"]),
            materials=[*map(_material, known), Material()],
            maps=maps,
            uv=lambda slot: arrays.get("uv" if slot is None else f"uv {slot}", bare),
            tiles=self._layers.folder.tiles,
            read=self._layers.image,
            has_factors=True,
        )

    def hidden_places(self) -> tuple[str, ...]:
        return ("further places of a mesh",) if self._words["counts"].get("instanced") else ()

    def references(self) -> Sequence[str]:
        if self._layers.package is not None:
            return []
        images = self._image_files()  # which reads the scene, and so finds the layers
        return [*self._other_layers(), *dict.fromkeys(images.values())]

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
            said, made = self._layers.ask(order, arrays)
            root = {self._layers.root: made["layer"].tobytes()}
            notices = (*sidecars.notices, *([_HIDES] if said["hides"] else []))
            sidecars = dataclasses.replace(sidecars, notices=notices)
        if package is None:
            return dataclasses.replace(sidecars, main=[*root.values()] or [self.data])
        files = {**root, **sidecars.sidecars}
        return Written(package.packed(files) if files else [self.data], notices=sidecars.notices)

    def sidecar_names(self, images: PlannedImages, naming: Naming, **_: object) -> list[str]:
        written = self._new_images(images, naming)[0]
        return written.sidecar_names if self._layers.package is None else []

    def _new_images(self, images: NewImages, naming: Naming) -> tuple[Written, dict[str, str]]:
        """Return the new files of the root layer or package, and the attributes with the new names."""
        kept = list[str]()
        if naming.copies and self._layers.package is None:
            kept = [*self._other_layers(), *self._kept(images)]
            taken = next((file for file in kept if naming.is_taken(file)), None)
            if taken is not None:  # other layers name the files that are copied
                cause = f"there is another '{taken}' in OUTPUT's folder, and one of its files needs that name"
                raise InputError(self.name, cause, "choose an empty folder")
        present = self._layers.package.members if self._layers.package else self.references()
        names = NewFiles(naming, self.name, present, [*self._located[1], *kept])
        names.copied |= {file: file for file in kept}
        renamed: dict[str, str] = {}
        for (path, changed), slots in self._replaced(images).items():
            attributes = self._attributes(path, slots)
            is_replaced = attributes == self._attributes(path)
            for attribute in sorted(
                self._attributes(path) - {use["attribute"] for use in self._words["uses"]}
            ):
                names.keep_shown(attribute, path)
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
        mesh, counts, arrays = self._mesh, self._words["counts"], self._arrays
        held = {
            "materials": self._words["materials"],
            "uncoloured meshes": any(map(counts.get, ("uncoloured", "flat", "unfit", "animated"))),
            "texture coordinates": any(
                np.isfinite(arrays[name]).any() for name in arrays if name.startswith("uv")
            ),
            "normals": np.isfinite(arrays["normals"]).any(),
        }
        alpha = arrays["opacity"].clip(0, 1).astype(np.float32) if counts.get("transparent") else None
        left_out = (*(what for what, found in held.items() if found), *self._left_out())
        return dataclasses.replace(mesh, alpha=alpha, left_out=left_out)

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        groups, normals = (tuple(self._words["meshes"]), self._arrays["mesh_of"]), self._arrays["normals"]
        mesh = dataclasses.replace(self._scene.mesh(self._left_out(), groups, normals), frame=self.frame)
        return with_vertex_colours(mesh, self, colours)

    def _left_out(self) -> list[str]:
        words = self._words
        others = [f"{kind} prims" for kind in words["others"]]
        others += ["variants"] if words["variants"] else []
        others += self.hidden_places()
        others += ["further vertex attributes"] if words["counts"].get("further") else []
        others += dict.fromkeys(lost for known in words["materials"] for lost in known["lost"])
        return [*others, *(["node hierarchy"] if len(words["meshes"]) > 1 else [])]

    def fingerprint(self) -> Fingerprint:
        self._compared = True
        words = self._words
        if "text" not in words:  # the scene was read for something else before
            words = self._layers.scene(text=True)[0]
        parts = {"root layer": words["text"].encode()}
        parts |= {f"layer {name}": self._layers.contents[name] for name in self._other_layers()}
        named = self._image_files()
        package = self._layers.package
        if package is not None:
            known = {*named.values(), *package.layers}
            others = [each for each in package.members if each not in known]
            parts |= {f"file {name}": package.read(name) for name in others}
        colours = {"vertex colours": self._painted.colours} if self.has_vertex_colours() else {}
        faults = package.faults() if package is not None else ()
        return Fingerprint(parts, colours, labelled(named, self._layers.image), faults)

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
