"""The triangles of a glTF file with texture coordinates: under the images of one slot, and with all materials."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import display_colour
from beltrami_cli.formats.gltf.accessors import (
    TRIANGLES,
    Accessors,
    attribute_accessor,
    drawing_key,
    drawing_mode,
    drawn_triangles,
    fitting_accessor,
    fractions,
    position_accessor,
)
from beltrami_cli.formats.gltf.container import Entry
from beltrami_cli.formats.gltf.painted import Placement, instances
from beltrami_cli.formats.gltf.textures import SLOT_PATHS, Images, image_key
from beltrami_cli.formats.gltf.writer import OWN_COLOURS
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.formats.textured_mesh import MeshImages, SlotImages, shown_materials, usable_coordinates
from beltrami_cli.surface import records
from beltrami_cli.surface.records import Slot

_MOST_ROWS = np.iinfo(np.int32).max
# Colours of the vertices of a primitive by mesh and number, shape (n, 3) or with opacity (n, 4), linear.
PrimitiveColours = Mapping[tuple[int, int], Float32s]

_ALPHA: dict[str, records.AlphaMode] = {"MASK": "mask", "BLEND": "blend"}
_TRANSFORM = "KHR_texture_transform"
_VARIANTS = "KHR_materials_variants"
_MOST_VARIANTS = 1 << 16
_KNOWN = ("POSITION", "NORMAL", "COLOR_0", OWN_COLOURS)


@dataclass(frozen=True)
class TextureUse:
    """A texture as one slot of one material uses it."""

    material: str  # name, for messages
    info: Entry  # the textureInfo
    texture: int
    coordinates: str  # the attribute with its texture coordinates, "TEXCOORD_0" or another
    transform: tuple[float, float, float, float, float, float]  # u' = a u + b v + c, v' = d u + e v + f
    alpha_hides: bool  # whether the material's alphaMode makes anything of opacity; OPAQUE does not

    def placed(self, uv: Float64s) -> Float64s:
        """Return texture coordinates, shape (n, 2), with the transform applied; overflow gives infinity."""
        a, b, c, d, e, f = self.transform
        with np.errstate(over="ignore", invalid="ignore"):
            moved: Float64s = uv @ np.array([[a, d], [b, e]]) + np.array([c, f])
        return moved


def present_slots(root: Entry) -> tuple[Slot, ...]:
    """Return the slots for which some material has a texture, the base colour first."""
    materials = root.entries("materials")
    return tuple(slot for slot in SLOT_PATHS if any(_infos(material, slot) for material in materials))


def texture_uses(root: Entry, slot: Slot) -> list[list[TextureUse]]:
    """Return the images of each material in a slot: none, one, or several alternatives."""
    count = len(root.entries("textures"))
    found: list[list[TextureUse]] = []
    for index, material in enumerate(root.entries("materials")):
        name = material.text("name") or f"material {index}"
        hides = material.text("alphaMode") in ("MASK", "BLEND")
        found.append([])
        for info in _infos(material, slot):
            transform = info.entry("extensions").entry(_TRANSFORM)
            owner = transform if "texCoord" in transform else info
            texture = info.integer("index", below=count)
            coordinates = f"TEXCOORD_{owner.integer('texCoord', default=0)}"
            found[-1].append(TextureUse(name, info, texture, coordinates, _affine(transform), hides))
    return found


def looks(primitive: Entry, materials: Sequence[Sequence[TextureUse]]) -> list[tuple[int, TextureUse | None]]:
    """Return how a primitive can be shown, as (look, use); primitives show the same look at the same time."""
    # Look 0 is what viewers show by default; then an extension's material in place of the core one, and variants.
    default = _of_material(primitive, materials)
    found: list[tuple[int, TextureUse | None]] = [(0, default[0] if default else None)]
    found += [(1, use) for use in default[1:]]
    for mapping in primitive.entry("extensions").entry(_VARIANTS).entries("mappings"):
        chosen = _of_material(mapping, materials)[:1]
        variants = mapping.integers("variants", below=_MOST_VARIANTS)
        found += [(2 + variant, use) for variant in variants for use in chosen]
    return found


def _infos(material: Entry, slot: Slot) -> list[Entry]:
    """Return the textureInfos that a material has for a slot, that of core glTF first."""
    found = []
    for *parents, last in SLOT_PATHS[slot]:
        holder = material
        for key in parents:
            holder = holder.entry(key)
        if last in holder:
            found.append(holder.entry(last))
    return found


def _of_material(holder: Entry, materials: Sequence[Sequence[TextureUse]]) -> Sequence[TextureUse]:
    return materials[holder.integer("material", below=len(materials))] if "material" in holder else ()


def _affine(transform: Entry) -> tuple[float, float, float, float, float, float]:
    """Return scale, then rotation, then offset."""
    # The rotation is counter-clockwise as seen in the image, where v points down; the specification's text and
    # examples mean that, though its GLSL turns the other way when read column by column.
    x, y = transform.numbers("offset", 2) or (0.0, 0.0)
    width, height = transform.numbers("scale", 2) or (1.0, 1.0)
    angle = transform.number("rotation", default=0.0)
    cosine, sine = float(np.cos(angle)), float(np.sin(angle))
    return cosine * width, sine * height, x, -sine * width, cosine * height, y


def gather_textured(
    root: Entry, accessors: Accessors, places: Sequence[Placement], images: Images, slot: Slot
) -> tuple[records.TexturedSurface, list[str]]:
    """Gather all triangles of a file and the images that one slot shows on them, with notices for the user."""
    gathering = _SurfaceReading(root, accessors, images, slot)
    for mesh, placement in zip(root.entries("meshes"), places, strict=True):
        for primitive in mesh.entries("primitives"):
            gathering.take(primitive, placement)
    if not len(gathering.shown):
        raise gathering.shown.refusal(root.name, is_bare=gathering.counts["bare"] > 0)
    sentences = {
        "instanced": "{} textured part(s) are shown at several places; each is smoothed once, at its first place.",
        "bare": f"{{}} primitive(s) have no texture coordinates for their {slot} texture.",
    }
    counted = [sentence.format(n) for key, sentence in sentences.items() if (n := gathering.counts[key])]
    return gathering.surface(), gathering.shown.notices() + counted


@dataclass
class _SurfacePart:
    """Triangles over one accessor of positions in one place and one look."""

    position: int
    placement: Placement
    look: int
    # Triangles, the texture coordinates of their corners, and the number of their texture.
    drawn: list[tuple[Int64s, Float64s, int]] = field(default_factory=list)


class _SurfaceReading:
    """Parts while primitives are being taken one by one."""

    def __init__(self, root: Entry, accessors: Accessors, images: Images, slot: Slot) -> None:
        self.accessors, self.images, self.materials = accessors, images, texture_uses(root, slot)
        self.shown = SlotImages(slot)
        self.parts: dict[Hashable, _SurfacePart] = {}
        self.counts = dict.fromkeys(("instanced", "bare"), 0)
        self._seen: set[Hashable] = set()
        self._decoded: dict[int, Float64s] = {}

    def take(self, primitive: Entry, placement: Placement) -> None:
        """Take one primitive: its triangles where they stand first, with all textures that they can have."""
        found = _triangles(primitive, self.accessors, placement)
        if found is None:
            return
        position, count, faces = found
        for look, use in looks(primitive, self.materials):
            image = self._image(primitive, use)
            if look and image is None:
                continue
            place = self.accessors.identity(position), placement.matrix.tobytes(), placement.space, look
            repeated = self._repeated(primitive, position, use)
            self.counts["instanced"] += not look and image is not None and (placement.nodes > 1 or repeated)
            if repeated:
                continue
            part = self.parts.setdefault(place, _SurfacePart(position, placement, look))
            if use is None or image is None:
                part.drawn.append((faces, np.zeros((len(faces), 3, 2)), -1))
            else:
                uv, wrap = self._coordinates(primitive, use, count)[faces], self.images.wrap(use.texture)
                texture = self.shown.show(image, use.material, wrap, alpha_hides=use.alpha_hides)
                part.drawn.append((faces, uv, texture))

    def _repeated(self, primitive: Entry, position: int, use: TextureUse | None) -> bool:
        """Return whether the same triangles were taken with the same texture before, there or elsewhere."""
        parts: list[Hashable] = [
            self.accessors.identity(position),
            drawing_key(primitive, self.accessors),
        ]
        if use is not None:
            parts += [use.texture, use.transform]
            if use.coordinates in primitive.entry("attributes"):
                coordinates = attribute_accessor(primitive, use.coordinates, self.accessors)
                parts.append(self.accessors.identity(coordinates))
        key = tuple(parts)
        repeated = key in self._seen
        self._seen.add(key)
        return repeated

    def _image(self, primitive: Entry, use: TextureUse | None) -> str | None:
        """Return the key of the image that a texture shows on a primitive; None if it shows none."""
        if use is None:
            return None
        if use.coordinates not in primitive.entry("attributes"):
            self.counts["bare"] += 1
            return None
        place = self.images.textures[use.texture].place
        try:
            image = self.images.canonical(self.images.shown(use.texture))
            if image_key(image) not in self.shown:
                place = self.images.entries[image].place
                self.shown.take(image_key(image), self.images.name(image), self.images.data(image))
        except UnfitReferenceError as error:
            self.shown.miss(f"{place}: {error}", use.material)
            return None
        return image_key(image)

    def _coordinates(self, primitive: Entry, use: TextureUse, count: int) -> Float64s:
        """Return the texture coordinates of all vertices, shape (count, 2), transform applied."""
        index = fitting_accessor(primitive, use.coordinates, self.accessors, "VEC2", count)
        if index not in self._decoded:  # parts of one large mesh may share it
            self._decoded[index] = self.accessors.values(index)
        uv = use.placed(self._decoded[index])
        if not np.isfinite(uv).all():
            raise use.info.fault("extensions", "its transform moves texture coordinates to infinity")
        return uv

    def surface(self) -> records.TexturedSurface:
        positions, faces, spaces, rows = [], [], [], 0  # without vertices that no triangle uses
        # Triangles of different looks or spaces do not meet.
        looks_in_spaces = dict.fromkeys((part.placement.space, part.look) for part in self.parts.values())
        space_of = {key: number for number, key in enumerate(looks_in_spaces)}
        for part in self.parts.values():
            corners = np.concatenate([faces for faces, _, _ in part.drawn])
            used = np.zeros(self.accessors[part.position].count, bool)
            used[corners] = True
            faces.append((np.cumsum(used) - 1 + rows)[corners])
            rows += int(np.count_nonzero(used))
            if rows > _MOST_ROWS:
                raise self.accessors[part.position].entry.fault("", f"more than {_MOST_ROWS} vertices")
            positions.append(part.placement.positions(self.accessors, part.position, used))
            spaces.append(np.full(len(positions[-1]), space_of[part.placement.space, part.look], np.int32))
        drawn = [each for part in self.parts.values() for each in part.drawn]
        return records.TexturedSurface(
            positions=np.concatenate(positions),
            faces=np.concatenate(faces).astype(np.int32),
            uv=np.concatenate([uv for _, uv, _ in drawn]),
            texture_of=np.concatenate([np.full(len(uv), number, np.int32) for _, uv, number in drawn]),
            textures=self.shown.textures(),
            space_of=np.concatenate(spaces) if len(space_of) > 1 else None,
        )


def _triangles(
    primitive: Entry, accessors: Accessors, placement: Placement
) -> tuple[int, int, Int64s] | None:
    """Return the accessor of positions, their number, and the triangles; None if none are drawn."""
    if drawing_mode(primitive) < TRIANGLES or "POSITION" not in primitive.entry("attributes"):
        return None
    position = position_accessor(primitive, accessors)
    count = accessors[position].count
    faces = placement.facing(drawn_triangles(primitive, accessors, count))
    return (position, count, faces) if len(faces) else None


def read_textured_mesh(
    root: Entry, accessors: Accessors, images: Images, colours: PrimitiveColours, stored: str, source: str
) -> records.TexturedMesh:
    """Return the triangles of the default scene, at every place where a node shows them, with their materials."""
    reading = _MeshReading(root, accessors, images, colours)
    for mesh, placement, name in instances(root):
        for number, primitive in enumerate(root.entries("meshes")[mesh].entries("primitives")):
            reading.take(primitive, placement, name, (mesh, number))
    if not reading.parts:
        raise InputError(root.name, "its scene has no triangles, so there is nothing to show a texture")
    return reading.mesh(stored, source)


@dataclass(frozen=True)
class _MeshPart:
    """The triangles of a primitive at one place; arrays have a row for each vertex, or for each corner."""

    positions: Float64s
    faces: Int64s
    uv: Float64s
    normals: Float64s
    colours: Float32s | None
    material: int
    group: str


class _MeshReading:
    """The materials of a file, and parts while primitives are being taken one by one."""

    def __init__(self, root: Entry, accessors: Accessors, images: Images, colours: PrimitiveColours) -> None:
        self._accessors, self._images, self._colours = accessors, images, colours
        self.parts: list[_MeshPart] = []
        self._rows = 0
        self._left_out: list[str] = []
        self._shown = MeshImages()
        self._placed: list[TextureUse | None] = []  # by material, how its maps are placed
        uses = {slot: texture_uses(root, slot) for slot in SLOT_PATHS}
        self._materials = [
            self._material(entry, {slot: uses[slot][index][0] for slot in SLOT_PATHS if uses[slot][index]})
            for index, entry in enumerate(root.entries("materials"))
        ]
        self._materials.append(records.Material(metalness=1.0))
        self._placed.append(None)

    def _material(self, entry: Entry, uses: Mapping[Slot, TextureUse]) -> records.Material:
        maps: dict[Slot, records.MaterialMap] = {}
        first: TextureUse | None = None
        for slot, use in uses.items():
            if first is not None and (use.coordinates, use.transform) != (first.coordinates, first.transform):
                self._left_out.append(f"{slot} maps with texture coordinates of their own")
                continue
            try:
                image = self._images.canonical(self._images.shown(use.texture))
                name, read = self._images.name(image), partial(self._images.data, image)
                number = self._shown.take(image_key(image), name, read)
                maps[slot] = records.MaterialMap(number, self._images.wrap(use.texture))
                first = first or use
            except UnfitReferenceError as error:
                self._left_out.append(f"a {slot} image, which {error}")
        self._placed.append(first)
        base = entry.entry("pbrMetallicRoughness")
        factor = base.numbers("baseColorFactor", 4) or [1.0] * 4
        self._left_out += entry.entry("extensions").value
        return records.Material(
            name=entry.text("name") or "",
            maps=maps,
            colour=display_colour(factor[:3]),
            emission=display_colour(entry.numbers("emissiveFactor", 3) or [0.0] * 3),
            opacity=min(max(factor[3], 0.0), 1.0),
            metalness=base.number("metallicFactor", default=1.0),
            roughness=base.number("roughnessFactor", default=1.0),
            alpha=_ALPHA.get(entry.text("alphaMode") or "", "opaque"),
        )

    def take(self, primitive: Entry, placement: Placement, group: str, number: tuple[int, int]) -> None:
        attributes = primitive.entry("attributes")
        if drawing_mode(primitive) < TRIANGLES and "POSITION" in attributes:
            self._left_out.append("points and lines")
        found = _triangles(primitive, self._accessors, placement)
        if found is None:
            return
        index, count, faces = found
        self._rows += count
        if self._rows > _MOST_ROWS:
            raise self._accessors[index].entry.fault("", f"more than {_MOST_ROWS} vertices")
        last = len(self._materials) - 1
        material = primitive.integer("material", below=last) if "material" in primitive else last
        use = self._placed[material]
        self._note_others(attributes, use)
        positions = placement.positions(self._accessors, index)
        uv = np.full((count, 2), np.nan)
        coordinates = "TEXCOORD_0" if use is None else use.coordinates
        if coordinates in attributes:
            stored = self._accessors.values(
                fitting_accessor(primitive, coordinates, self._accessors, "VEC2", count)
            )
            uv = usable_coordinates(stored if use is None else use.placed(stored))
        normals = np.full((count, 3), np.nan)
        if "NORMAL" in attributes:
            normal = fitting_accessor(primitive, "NORMAL", self._accessors, "VEC3", count)
            normals = placement.normals(self._accessors, normal)
        colours = self._own_colours(primitive, number, count)
        self.parts.append(_MeshPart(positions, faces, uv[faces], normals[faces], colours, material, group))

    def _note_others(self, attributes: Entry, use: TextureUse | None) -> None:
        coordinates = "TEXCOORD_0" if use is None else use.coordinates
        for name in attributes.value:
            if name.startswith("TEXCOORD_") and name != coordinates:
                self._left_out.append("further texture coordinates")
            elif name not in _KNOWN and name != coordinates and not name.startswith(("JOINTS_", "WEIGHTS_")):
                self._left_out.append(f"attribute {name}")

    def _own_colours(self, primitive: Entry, number: tuple[int, int], count: int) -> Float32s | None:
        if number in self._colours:
            material = primitive.value.get("material", len(self._materials) - 1)
            is_white = (self._colours[number][:, :3] == 1).all()
            if "baseColor" in self._materials[material].maps and not is_white:
                self._left_out.append("the tint of textures by their vertex colours")
            return self._colours[number]
        if OWN_COLOURS not in primitive.entry("attributes"):
            return None
        index = attribute_accessor(primitive, OWN_COLOURS, self._accessors)
        colours = fractions(self._accessors.finite(index, "colour"))
        return colours if colours.shape in ((count, 3), (count, 4)) else None

    def mesh(self, stored: str, source: str) -> records.TexturedMesh:
        starts = np.cumsum([0, *(len(part.positions) for part in self.parts)])[:-1]
        placed = zip(self.parts, starts.tolist(), strict=True)
        normals = np.concatenate([part.normals for part in self.parts]).astype(np.float32)
        counts = [len(part.faces) for part in self.parts]
        groups = tuple(dict.fromkeys(part.group for part in self.parts))
        group_of = np.repeat([groups.index(part.group) for part in self.parts], counts)
        numbers = np.repeat([part.material for part in self.parts], counts)
        materials, material_of = shown_materials(self._materials, numbers)
        return records.TexturedMesh(
            positions=np.concatenate([part.positions for part in self.parts]),
            faces=np.concatenate([part.faces + start for part, start in placed]).astype(np.int32),
            uv=np.concatenate([part.uv for part in self.parts]),
            materials=materials,
            images=tuple(self._shown.images),
            source=source,
            material_of=material_of,
            groups=groups,
            group_of=group_of.astype(np.int32),
            normals=None if np.isnan(normals).all() else normals,
            colours=self._vertex_colours(stored),
            left_out=tuple(self._left_out),
        )

    def _vertex_colours(self, stored: str) -> records.VertexColours | None:
        """Return the colours of all vertices; white for parts without colours, as glTF has it."""
        if all(part.colours is None for part in self.parts):
            return None
        rows, row = np.ones((self._rows, 4), np.float32), 0
        for part in self.parts:
            if part.colours is not None:
                rows[row : row + len(part.colours), : part.colours.shape[1]] = part.colours
            row += len(part.positions)
        alpha = rows[:, 3] if (rows[:, 3] < 1).any() else None
        return records.VertexColours(rows[:, :3], "linear", stored, alpha)
