"""The triangles of a glTF file with the texture coordinates of one slot, and the images of that slot."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.beside import UnfitReferenceError
from beltrami_cli.formats.gltf.materials import Painting, paintings
from beltrami_cli.formats.gltf.primitives import (
    attribute_accessor,
    drawing_mode,
    drawn,
    identity,
    in_world,
    index_accessor,
    position_accessor,
)
from beltrami_cli.formats.gltf.triangles import TRIANGLES
from beltrami_cli.mesh.textured import Texture, TexturedSurface

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.pictures import Pictures
    from beltrami_cli.formats.gltf.scene import Placement
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.mesh.textured import Slot, Wrap

_MOST_ROWS = np.iinfo(np.int32).max


def key_of(image: int) -> str:
    """Return the key under which an image is handed out."""
    return f"image {image}"


def gather_textured(
    root: Entry, accessors: Accessors, places: Sequence[Placement], pictures: Pictures, slot: Slot
) -> tuple[TexturedSurface, list[str]]:
    """Gather all triangles of a file, and the images that one slot of their materials shows.

    Returns
    -------
    surface : TexturedSurface
        Vertices that no triangle uses are left out.
    notices : list of str
        What the user should be told.

    Raises
    ------
    InputError
        If no texture of the slot can be read, or the geometry or texture coordinates are damaged or compressed.
    """
    gathering = _Gathering(accessors, pictures, slot, paintings(root, slot))
    for mesh, placement in zip(root.entries("meshes"), places, strict=True):
        for primitive in mesh.entries("primitives"):
            gathering.take(primitive, placement)
    if not gathering.painted:
        raise InputError(root.name, gathering.excuse())
    return gathering.surface(), gathering.notices()


@dataclass
class _Part:
    """Triangles over one accessor of positions in one place."""

    position: int
    placement: Placement
    faces: list[NDArray[np.int64]] = field(default_factory=list)
    uv: list[NDArray[np.float64]] = field(default_factory=list)
    texture: list[NDArray[np.int32]] = field(default_factory=list)


@dataclass
class _Painted:
    """An image that the surface shows: its file, and who uses it."""

    number: int
    data: bytes
    wraps: list[tuple[Wrap, Wrap]] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    hides: bool = False


class _Gathering:
    """Parts and images while primitives are being taken one by one."""

    def __init__(
        self, accessors: Accessors, pictures: Pictures, slot: Slot, palette: Sequence[Painting | None]
    ) -> None:
        self.accessors, self.pictures, self.slot, self.palette = accessors, pictures, slot, palette
        self.parts: dict[Hashable, _Part] = {}
        self.painted: dict[int, _Painted] = {}
        self._missing: dict[str, list[str]] = {}
        self._seen: set[Hashable] = set()
        self._counts = dict.fromkeys(("instanced", "bare", "variants"), 0)
        self._decoded: dict[int, NDArray[np.float64]] = {}

    def take(self, primitive: Entry, placement: Placement) -> None:
        """Take one primitive: its triangles where they stand first, with their texture if they have one."""
        if drawing_mode(primitive) < TRIANGLES:
            return
        if "POSITION" not in primitive.entry("attributes"):
            return  # it draws nothing
        position = position_accessor(primitive, self.accessors)
        count = self.accessors[position].count
        faces = drawn(primitive, self.accessors, count, placement)
        if not len(faces):
            return
        painting, image = self._painting(primitive)
        self._counts["variants"] += "KHR_materials_variants" in primitive.entry("extensions")
        self._counts["instanced"] += image is not None and placement.nodes > 1
        if self._repeated(primitive, position, painting):
            self._counts["instanced"] += image is not None and placement.nodes <= 1
            return
        uv, number = np.zeros((len(faces), 3, 2)), -1
        if painting is not None and image is not None:
            uv = self._coordinates(primitive, painting, count)[faces]
            number = self._use(image, painting)
        place = (identity(self.accessors, position), placement.matrix.tobytes(), placement.space)
        part = self.parts.setdefault(place, _Part(position, placement))
        part.faces.append(faces)
        part.uv.append(uv)
        part.texture.append(np.full(len(faces), number, np.int32))

    def _repeated(self, primitive: Entry, position: int, painting: Painting | None) -> bool:
        """Return whether the same triangles were taken with the same texture before, there or elsewhere."""
        index = index_accessor(primitive, self.accessors)
        key: list[Hashable] = [identity(self.accessors, position), drawing_mode(primitive)]
        key.append(None if index is None else identity(self.accessors, index))
        if painting is not None:
            coordinates = self._coordinate_accessor(primitive, painting)
            key += [painting.texture, painting.transform]
            key.append(None if coordinates is None else identity(self.accessors, coordinates))
        repeated = tuple(key) in self._seen
        self._seen.add(tuple(key))
        return repeated

    def _painting(self, primitive: Entry) -> tuple[Painting | None, int | None]:
        """Return what a primitive's material has in the slot, and its image if that can be shown."""
        if "material" not in primitive:
            return None, None
        painting = self.palette[primitive.integer("material", below=len(self.palette))]
        if painting is None:
            return None, None
        try:
            image = self.pictures.canonical(self.pictures.shown(painting.texture))
        except UnfitReferenceError as error:
            self._miss(f"{self.pictures.textures[painting.texture].place}: {error}", painting)
            return painting, None
        if painting.coordinates not in primitive.entry("attributes"):
            self._counts["bare"] += 1
            return painting, None
        return painting, image if self._loaded(image, painting) else None

    def _loaded(self, image: int, painting: Painting) -> bool:
        if image not in self.painted:
            try:
                data = self.pictures.data(image)
            except UnfitReferenceError as error:
                self._miss(f"{self.pictures.images[image].place}: {error}", painting)
                return False
            self.painted[image] = _Painted(len(self.painted), data)
        return True

    def _miss(self, reason: str, painting: Painting) -> None:
        materials = self._missing.setdefault(reason, [])
        if painting.material not in materials:
            materials.append(painting.material)

    def _use(self, image: int, painting: Painting) -> int:
        painted = self.painted[image]
        painted.wraps.append(self.pictures.wrap(painting.texture))
        painted.hides |= painting.alpha_hides
        if painting.material not in painted.materials:
            painted.materials.append(painting.material)
        return painted.number

    def _coordinate_accessor(self, primitive: Entry, painting: Painting) -> int | None:
        if painting.coordinates not in primitive.entry("attributes"):
            return None
        return attribute_accessor(primitive, painting.coordinates, self.accessors)

    def _coordinates(self, primitive: Entry, painting: Painting, count: int) -> NDArray[np.float64]:
        """Return the texture coordinates of all vertices, shape (count, 2), transform applied."""
        index = attribute_accessor(primitive, painting.coordinates, self.accessors)
        accessor = self.accessors[index]
        if accessor.shape != "VEC2" or accessor.component.name == "uint32" or accessor.count != count:
            cause = f"is {accessor.count} {accessor.shape} of {accessor.component.name}"
            attributes = primitive.entry("attributes")
            raise attributes.fault(painting.coordinates, f"{cause}, not {count} texture coordinates")
        uv = painting.placed(self._values(index))
        if not np.isfinite(uv).all():
            raise painting.info.fault("extensions", "its transform moves texture coordinates to infinity")
        return uv

    def _values(self, index: int) -> NDArray[np.float64]:
        if index not in self._decoded:
            self._decoded[index] = self.accessors.values(index)
        return self._decoded[index]

    def surface(self) -> TexturedSurface:
        """Return what was gathered."""
        positions, faces, spaces, rows = [], [], [], 0
        for part in self.parts.values():
            corners = np.concatenate(part.faces)
            used = np.zeros(self.accessors[part.position].count, bool)
            used[corners] = True
            faces.append((np.cumsum(used) - 1 + rows)[corners])
            rows += int(np.count_nonzero(used))
            if rows > _MOST_ROWS:
                raise self.accessors[part.position].entry.fault("", f"more than {_MOST_ROWS} vertices")
            values = self._values(part.position)[used]
            positions.append(in_world(values, part.placement, self.accessors, part.position))
            spaces.append(np.full(len(values), part.placement.space, np.int32))
        space_of = np.concatenate(spaces)
        return TexturedSurface(
            positions=np.concatenate(positions),
            faces=np.concatenate(faces).astype(np.int32),
            uv=np.concatenate([uv for part in self.parts.values() for uv in part.uv]),
            texture_of=np.concatenate([number for part in self.parts.values() for number in part.texture]),
            textures=tuple(self._texture(image, painted) for image, painted in self.painted.items()),
            space_of=space_of if np.any(space_of != space_of[:1]) else None,
        )

    def _texture(self, image: int, painted: _Painted) -> Texture:
        name = self.pictures.name(image)
        materials = tuple(painted.materials)
        return Texture(key_of(image), name, painted.data, materials, painted.wraps[0], painted.hides)

    def excuse(self) -> str:
        """Return why no texture of the slot can be shown."""
        if self._missing:
            return f"its {self.slot} texture cannot be read: {next(iter(self._missing))}"
        if self._counts["bare"]:
            return f"it has a {self.slot} texture, but no texture coordinates for it"
        return f"it has no {self.slot} texture"

    def notices(self) -> list[str]:
        """Return what the user should know."""
        found = [
            f"The {self.slot} texture of {', '.join(map(repr, materials))} is left as it is: {reason}."
            for reason, materials in self._missing.items()
        ]
        found += [
            f"The {self.slot} image {self.pictures.name(image)!r} is used with several wrap modes; the first is "
            "followed."
            for image, painted in self.painted.items()
            if len(set(painted.wraps)) > 1
        ]
        sentences = {
            "instanced": "{} textured part(s) are shown at several places; each is smoothed once, at its first "
            "place.",
            "bare": f"{{}} primitive(s) have no texture coordinates for their {self.slot} texture.",
            "variants": "{} primitive(s) have material variants; only the materials shown by default are smoothed.",
        }
        return found + [sentence.format(n) for key, sentence in sentences.items() if (n := self._counts[key])]
