"""A glTF 2.0 file, text or binary; only vertex colours, their positions and images are replaced.

A new image or buffer never takes the name of a file that the source uses, unless the output replaces the source.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes, Changes, Naming, PlannedImages, Written
from beltrami_cli.formats.comparison import Fingerprint
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.gltf.accessors import DRACO, Accessors
from beltrami_cli.formats.gltf.buffers import Buffers, SidecarFiles, data_uri, is_data, located, named_views
from beltrami_cli.formats.gltf.container import (
    BIN_CHUNK,
    JSON_CHUNK,
    Chunk,
    Container,
    Tree,
    glb_pieces,
    objects,
    primitives_of,
    read_container,
    require_structure,
    revised,
)
from beltrami_cli.formats.gltf.edit import Edit, accessor_uses, merge_buffers
from beltrami_cli.formats.gltf.textured import gather_textured, present_slots, read_textured_mesh
from beltrami_cli.formats.gltf.textures import (
    IMAGE_EXTENSIONS,
    Images,
    embed_images,
    show_images,
    texture_infos,
)
from beltrami_cli.formats.gltf.vertex_colours import Surface, placements
from beltrami_cli.formats.model_folder import ModelFolder, UnfitReferenceError, is_outside
from beltrami_cli.formats.new_files import NewFiles
from beltrami_cli.surface.records import (
    ColouredVertices,
    ImageFile,
    MeshContents,
    Slot,
    Texture,
    TexturedSurface,
)

# What conversion leaves out of a file with textures, too.
_NOT_TEXTURED = ("skins", "animations", "cameras", "morph targets")


class GltfDocument(Document):
    """An opened glTF file, in either form."""

    format: str  # type: ignore[misc]  # one class reads both forms, so only an instance knows its format
    forms = ("glb", "gltf", "vrm")

    def _open(self, folder: Path | None) -> None:
        self._folder = ModelFolder(folder, self.access)
        self.container = read_container(self.data, self.name)
        self.format = self.container.kind
        self.root = self.container.root
        require_structure(self.root)
        self.buffers = Buffers(self.container, self._folder)
        self.accessors = Accessors(self.root, self.buffers)
        self.places = placements(self.root)
        self.images = Images(self.root, self.accessors, self._folder)
        self._files = SidecarFiles(self.root, self._folder)
        if self.container.has_bom:
            self.notices = ["The JSON starts with a byte order mark, which glTF does not allow; it is kept."]
        self.obstacles += self._files.obstacles
        self.notices += [f"{each.cause}." for each in self._files.obstacles]

    @cached_property
    def surface(self) -> Surface:
        surface = Surface(self.name, self.accessors, self.places)
        self.notices += surface.notices()
        return surface

    @cached_property
    def _coloured_vertices(self) -> ColouredVertices:
        return self.surface.vertices()

    def has_vertex_colours(self) -> bool:
        primitives = primitives_of(self.container.tree)
        return any("COLOR_0" in primitive.get("attributes", {}) for _, primitive in primitives)

    def slots(self) -> tuple[Slot, ...]:
        return present_slots(self.root)

    def _gathered(self, slot: Slot) -> TexturedSurface:
        surface, notices = gather_textured(self.root, self.accessors, self.places, self.images, slot)
        self.notices += [notice for notice in notices if notice not in self.notices]
        return surface

    def hidden_places(self) -> tuple[str, ...]:
        shown = [str(node["mesh"]) for node in objects(self.container.tree.get("nodes")) if "mesh" in node]
        return ("further places of a mesh",) if len({*shown}) < len(shown) else ()

    def attributes(self) -> tuple[str, ...]:
        return self.surface.attribute_names()

    def _attribute(self, name: str) -> Float64s:
        if name == "normal" and (normals := self.surface.normals()) is not None:
            return normals.astype(np.float64)
        return self.surface.attribute(name)

    def require_movable(self) -> None:
        self.surface.require_movable()

    def _patched(self, new: Changes, naming: Naming) -> Written:
        edit = Edit(self.container, self.accessors, self.container.copy_of_tree())
        if new.colours is not None:
            self.surface.recolour(edit, self.coloured_vertices().colours, new.colours)
        if new.places is not None:
            self.surface.move(edit, self.coloured_vertices().positions, new.places)
        show_images(edit, self.images, new.images)
        return _written(edit, naming, new.form or self.format, self._folder)

    def sidecar_names(
        self, images: PlannedImages, naming: Naming, *, colours: bool, places: bool = False, form: str | None = None
    ) -> list[str]:  # fmt: skip
        form = form or self.format
        if form != "gltf" and not (self.format == "glb" and self._files.any):
            return []
        edit = Edit(self.container, self.accessors, self.container.copy_of_tree())
        if colours:
            self.surface.replace_all(edit, places=places)
        show_images(edit, self.images, images)
        edit.finish()
        return _placed(edit, naming, form, self._folder).written().sidecar_names

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
            alpha=self.surface.opacity(),
            normals=self.surface.normals(),
            left_out=(*_omitted(self.container.tree), *self._extensions(), *self.hidden_places()),
        )

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        stored = "float32"
        by_primitive: dict[tuple[int, int], Float32s] = {}
        if self.has_vertex_colours():
            shown = self.coloured_vertices()
            stored, values = shown.stored, shown.colours if colours is None else colours
            alpha = self.surface.opacity()
            rows = values if alpha is None else np.column_stack([values, alpha])
            for block in self.surface.blocks:
                by_primitive |= dict.fromkeys(block.users, rows[block.rows])
        known = self.root, self.accessors, self.images
        mesh = read_textured_mesh(*known, by_primitive, stored)
        losses = [what for what in _omitted(self.container.tree) if what in _NOT_TEXTURED]
        losses += self._extensions()
        if any(node.get("children") for node in objects(self.container.tree.get("nodes"))):
            losses.append("node hierarchy")
        return dataclasses.replace(mesh, left_out=(*mesh.left_out, *losses))

    def _extensions(self) -> list[str]:
        """Return the extensions of the file and of its nodes, such as avatars and instances."""
        parts = [self.root, *self.root.entries("nodes")]
        return sorted({name for part in parts for name in part.entry("extensions").value})

    def fingerprint(self) -> Fingerprint:
        parts, images = fingerprint(self.container, self.accessors, self.images)
        colours: dict[str, Float32s] = {}
        if self.has_vertex_colours():
            colours["vertex colours"] = self.coloured_vertices().colours
            opacity = [
                stored[:, 3].tobytes() for stored in self.surface.stored_colours if stored.shape[1] == 4
            ]
            parts["opacity of vertex colours"] = b"".join(opacity)
        return Fingerprint(parts, colours, images)

    def facts(self) -> dict[str, object]:
        root, asset = self.root, self.root.entry("asset")
        primitives = [primitive for _, primitive in primitives_of(self.container.tree)]
        named = {primitive.get("attributes", {}).get("COLOR_0", -1) for primitive in primitives}
        there = (index for index in sorted(named) if 0 <= index < len(self.accessors))
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
                for index, accessor in ((index, self.accessors[index]) for index in there)
            ],
            "materials": len(root.entries("materials")),
            "images": len(self.images),
            "textures": len(self.images.textures),
            "slots": list(self.slots()),
            "skins": len(root.entries("skins")),
            "animations": len(root.entries("animations")),
            "extensions used": self.container.tree.get("extensionsUsed", []),
            "extensions required": self.container.tree.get("extensionsRequired", []),
        }


def _omitted(tree: Tree) -> list[str]:
    primitives = [primitive for _, primitive in primitives_of(tree)]
    sets = [primitive.get("attributes", {}) for primitive in primitives]
    attributes, nodes = {key for each in sets for key in each}, objects(tree.get("nodes"))
    placed = ("children", "matrix", "translation", "rotation", "scale")
    there = {key: tree.get(key) for key in ("materials", "textures", "skins", "animations", "cameras")} | {
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
    return [what for what, found in there.items() if found]


_PLACE = ("uri", "bufferView", "mimeType")  # of an image
_NUMBERS_OF_COLOURS = ("bufferView", "byteOffset", "sparse", "min", "max")
_PACKED_PLACE = ("buffer", "byteOffset", "byteLength")  # of compressed bytes, in the extension of a view


def fingerprint(
    container: Container, accessors: Accessors, images: Images
) -> tuple[dict[str, bytes], dict[str, Texture]]:
    """Return all parts of a glTF file but its colours and images, and its images."""
    # Entries that a patch may add or that say where images and colours are stored become None.
    tree, textures = container.copy_of_tree(), dict[str, Texture]()
    parts = {f"chunk {n} of type {c.kind:#x}": bytes(c.data) for n, c in enumerate(container.unknown_chunks)}
    parts["what follows the last chunk"] = bytes(container.tail)
    parts["byte order mark"] = bytes([container.has_bom])
    for key in ("extensionsUsed", "extensionsRequired"):
        tree[key] = [name for name in tree.get(key, []) if name not in IMAGE_EXTENSIONS]
    buffers = [
        {k: v for k, v in each.items() if k not in ("uri", "byteLength")} for each in tree.get("buffers", [])
    ]
    tree["buffers"] = [each or None for each in buffers]
    _hide_images(images, tree, textures)
    parts |= _hide_colours(tree) | _numbers(accessors, container.tree, tree)
    for key, value in tree.items():
        entries = (
            {f"{key}[{n}]": each for n, each in enumerate(value)} if isinstance(value, list) else {key: value}
        )
        parts |= {place: _spelled(each) for place, each in entries.items() if each is not None}
    return parts, textures


def _hide_images(images: Images, tree: Tree, textures: dict[str, Texture]) -> None:
    """Describe textures where materials name them, without where their images are, and note the images."""
    apart = ("materials", "accessors", "bufferViews", "buffers", "images", "textures")
    others = [texture_infos(value, key) for key, value in tree.items() if key not in apart]
    shown, elsewhere = set(), {info["index"] for infos in others for _, info in infos}
    for place, info in texture_infos(tree.get("materials"), "materials"):
        number = info.pop("index")
        if 0 <= number < len(images.textures):
            shown.add(number)
            info["texture"] = _texture(images, tree, number, place, textures)
    tree["textures"] = [
        _texture(images, tree, number, f"textures[{number}]", textures)
        if number not in shown or number in elsewhere
        else None
        for number in range(len(images.textures))
    ]
    tree.pop("images", None)


def _texture(images: Images, tree: Tree, number: int, place: str, textures: dict[str, Texture]) -> Tree:
    """Return a texture without where its image is, and note the image."""
    texture = dict(tree["textures"][number])
    texture.pop("source", None)
    kept = {k: v for k, v in texture.pop("extensions", {}).items() if k not in IMAGE_EXTENSIONS}
    try:
        image = images.shown(number)
        textures[place] = Texture(place, images.name(image), images.data(image))
    except UnfitReferenceError as error:
        return texture | {"extensions": kept, "image": str(error)}
    others = {key: value for key, value in tree["images"][image].items() if key not in _PLACE}
    return texture | {"extensions": kept, "image": others}


def _hide_colours(tree: Tree) -> dict[str, bytes]:
    """Take the colours of vertices out of a tree; return what their accessors say but for the numbers."""
    parts, accessors = {}, objects(tree.get("accessors"))
    for (mesh, number), primitive in primitives_of(tree):
        packed = primitive.get("extensions", {}).get(DRACO, {})
        packed.get("attributes", {}).pop("COLOR_0", None)
        colour = primitive.get("attributes", {}).pop("COLOR_0", -1)
        if 0 <= colour < len(accessors):
            kept = {k: v for k, v in accessors[colour].items() if k not in _NUMBERS_OF_COLOURS}
            kept["bounds"] = [key for key in ("min", "max") if key in accessors[colour]]
            parts[f"colours of meshes[{mesh}].primitives[{number}]"] = _spelled(kept)
    return parts


def _numbers(accessors: Accessors, source: Tree, tree: Tree) -> dict[str, bytes]:
    """Return the numbers of accessors, and the bytes of other views; hide accessors and views of colours alone."""
    parts: dict[str, bytes] = {}
    used = {holder[key] for _, holder, key in accessor_uses(tree)}
    colours = {primitive.get("attributes", {}).get("COLOR_0") for _, primitive in primitives_of(source)}
    opaque = set(named_views({key: value for key, value in tree.items() if key != "accessors"}))
    views = set(opaque)
    for index, accessor in enumerate(tree.get("accessors", [])):
        if index in colours and index not in used:
            tree["accessors"][index] = None
            continue
        views |= set(named_views(accessor))
        try:
            parts[f"numbers of accessors[{index}]"] = accessors[index].stored().tobytes()
        except InputError as error:
            parts[f"numbers of accessors[{index}]"] = str(error.cause).encode()
    for index, view in enumerate(tree.get("bufferViews", [])):
        tree["bufferViews"][index] = _view(view) if index in views else None
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


def _written(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> Written:
    """Return the files of an edit; the source itself if nothing was edited and the form is its own."""
    container, keeps_form = edit.container, (form == "gltf") == (edit.container.kind == "gltf")
    if form != "gltf" and not keeps_form:
        return _as_glb(edit, folder)
    edit.finish()
    names = _placed(edit, naming, form, folder)
    if not keeps_form:
        main: list[Bytes] = [revised(container.text, edit.tree).encode()]
        lost = [chunk for chunk in container.chunks if chunk.kind != BIN_CHUNK]
        if lost:
            edit.notices.append(f"{len(lost)} GLB chunk(s) of unknown type cannot be kept in a .gltf file.")
    elif not edit.buffers and not edit.images and edit.tree == container.tree:
        main = [container.data]
    else:
        main = container.rebuilt(edit.tree, edit.buffers.get(0) if edit.source(0) == "chunk" else None)
    return names.written(main, edit.notices)


def _placed(edit: Edit, naming: Naming, form: str, folder: ModelFolder) -> NewFiles:
    """Name the sidecar files of an edited glTF, and put their names into the tree."""
    used = SidecarFiles(edit.container.root, folder)
    names = NewFiles(naming, edit.container.name, used.present, used.missing)
    files = [*_files(edit, folder)]
    if form == "gltf" and edit.tree.get("buffers") and edit.source(0) == "chunk":
        data: Bytes = edit.buffers[0] if 0 in edit.buffers else edit.accessors.buffers.stored(0)
        length, name = edit.tree["buffers"][0]["byteLength"], names.new(".bin")
        edit.tree["buffers"][0]["uri"] = quote(name)
        names.sidecars[name] = data[:length] if len(data) - length < 4 else data  # without the padding
    # Only one image takes the name of a file, and none if another still shows that.
    taken = {path for _, path, new in files if new is None}
    new_of: dict[tuple[str, ImageFile | None], str] = {}
    for entry, path, new in files:
        if new is None and (not names.copies or path in used.missing):
            continue
        if new is None and is_outside(path):
            names.leave(entry["uri"])
            continue
        file = new if isinstance(new, ImageFile) else None
        if (path, file) not in new_of:
            is_buffer = "byteLength" in entry
            suffix, is_replaced = None if file is None else file.suffix, file is None or path not in taken
            name = (
                names.other(path, ".bin") if is_buffer else names.image(path, suffix, is_replaced=is_replaced)
            )
            new_of[path, file] = name
            taken.add(path)
            if new is None:
                names.copied[name] = path
            else:
                names.sidecars[name] = new.data if isinstance(new, ImageFile) else new
        if new_of[path, file] != path:
            entry["uri"] = quote(new_of[path, file])
    return names


def _files(edit: Edit, folder: ModelFolder) -> Iterator[tuple[Tree, str, Bytes | ImageFile | None]]:
    """Yield the buffers and images that are files: entry, path, and new content if it changes.

    Buffers that are data URIs get theirs.
    """
    canonical = edit.accessors.buffers.canonical
    buffers = [(each, edit.buffers.get(canonical(n))) for n, each in enumerate(edit.tree.get("buffers", []))]
    images = [(each, edit.images.get(n)) for n, each in enumerate(edit.tree.get("images", []))]
    for entry, new in [*buffers, *images]:
        uri = entry.get("uri")
        if uri is not None and not is_data(uri):
            with suppress(UnfitReferenceError):
                yield entry, located(uri, folder, must_exist=False), new
        elif uri is not None and isinstance(new, bytearray):
            entry["uri"] = data_uri(uri, new)


def _as_glb(edit: Edit, folder: ModelFolder) -> Written:
    """Return a text file as binary: all buffers merged into BIN, images inside the folder embedded."""
    embed_images(edit, folder)
    edit.finish()
    binary = merge_buffers(edit)
    chunks = [Chunk(JSON_CHUNK, revised(edit.container.text, edit.tree).strip(" \t\r\n").encode())]
    chunks += [Chunk(BIN_CHUNK, binary)] if binary else []
    return Written(glb_pieces(chunks), notices=tuple(edit.notices))
