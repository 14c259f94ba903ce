"""The triangles of a glTF file with the texture coordinates of one slot, and the images of that slot."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.materials import looks, paintings
from beltrami_cli.formats.gltf.primitives import (
    attribute_accessor,
    drawing_mode,
    drawn,
    identity,
    in_world,
    index_accessor,
    position_accessor,
)
from beltrami_cli.formats.gltf.shown import Shown
from beltrami_cli.formats.gltf.triangles import TRIANGLES
from beltrami_cli.formats.model_folder import remedy_for
from beltrami_cli.surface.records import TexturedSurface

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.materials import Painting
    from beltrami_cli.formats.gltf.pictures import Pictures
    from beltrami_cli.formats.gltf.scene import Placement
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.surface.records import Slot

_MOST_ROWS = np.iinfo(np.int32).max


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
    shown = Shown(pictures, slot)
    gathering = _Gathering(accessors, shown, paintings(root, slot))
    for mesh, placement in zip(root.entries("meshes"), places, strict=True):
        for primitive in mesh.entries("primitives"):
            gathering.take(primitive, placement)
    if not len(shown):
        bare = f"a {slot} texture, but no texture coordinates for it" if gathering.counts["bare"] else ""
        cause = shown.excuse() or f"it has {bare or f'no {slot} texture'}"
        raise InputError(root.name, cause, remedy_for(cause))
    return gathering.surface(), shown.notices() + _notices(gathering.counts, slot)


@dataclass
class _Part:
    """Triangles over one accessor of positions in one place and one look."""

    position: int
    placement: Placement
    look: int
    faces: list[NDArray[np.int64]] = field(default_factory=list)
    uv: list[NDArray[np.float64]] = field(default_factory=list)
    texture: list[NDArray[np.int32]] = field(default_factory=list)

    def add(self, uv: NDArray[np.float64], texture: int) -> None:
        """Say how the triangles that came last are painted."""
        self.uv.append(uv)
        self.texture.append(np.full(len(uv), texture, np.int32))


class _Gathering:
    """Parts while primitives are being taken one by one."""

    def __init__(self, accessors: Accessors, shown: Shown, palette: Sequence[Sequence[Painting]]) -> None:
        self.accessors, self.shown, self.palette = accessors, shown, palette
        self.parts: dict[Hashable, _Part] = {}
        self.counts = dict.fromkeys(("instanced", "bare"), 0)
        self._seen: set[Hashable] = set()
        self._decoded: dict[int, NDArray[np.float64]] = {}

    def take(self, primitive: Entry, placement: Placement) -> None:
        """Take one primitive: its triangles where they stand first, with all textures that they can have."""
        if drawing_mode(primitive) < TRIANGLES:
            return
        if "POSITION" not in primitive.entry("attributes"):
            return  # it draws nothing
        position = position_accessor(primitive, self.accessors)
        count = self.accessors[position].count
        faces = drawn(primitive, self.accessors, count, placement)
        if not len(faces):
            return
        for look, painting in looks(primitive, self.palette):
            image = self._image(primitive, painting)
            if look and image is None:
                continue
            place = identity(self.accessors, position), placement.matrix.tobytes(), placement.space, look
            self.counts["instanced"] += not look and image is not None and placement.nodes > 1
            if self._repeated(primitive, position, painting):
                self.counts["instanced"] += not look and image is not None and placement.nodes <= 1
                continue
            part = self.parts.setdefault(place, _Part(position, placement, look))
            part.faces.append(faces)
            if painting is None or image is None:
                part.add(np.zeros((len(faces), 3, 2)), -1)
            else:
                part.add(
                    self._coordinates(primitive, painting, count)[faces], self.shown.use(image, painting)
                )

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

    def _image(self, primitive: Entry, painting: Painting | None) -> int | None:
        """Return the image that a painting shows on a primitive, if it can."""
        if painting is None:
            return None
        if painting.coordinates not in primitive.entry("attributes"):
            self.counts["bare"] += 1
            return None
        return self.shown.image(painting)

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
        space_of = _spaces(self.parts.values())
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
            spaces.append(np.full(len(values), space_of[part.placement.space, part.look], np.int32))
        return TexturedSurface(
            positions=np.concatenate(positions),
            faces=np.concatenate(faces).astype(np.int32),
            uv=np.concatenate([uv for part in self.parts.values() for uv in part.uv]),
            texture_of=np.concatenate([number for part in self.parts.values() for number in part.texture]),
            textures=self.shown.textures(),
            space_of=np.concatenate(spaces) if len(space_of) > 1 else None,
        )


def _spaces(parts: Iterable[_Part]) -> dict[tuple[int, int], int]:
    """Return a number for every look in every space: triangles of different ones do not meet."""
    found: dict[tuple[int, int], int] = {}
    for part in parts:
        found.setdefault((part.placement.space, part.look), len(found))
    return found


def _notices(counts: Mapping[str, int], slot: Slot) -> list[str]:
    sentences = {
        "instanced": "{} textured part(s) are shown at several places; each is smoothed once, at its first place.",
        "bare": f"{{}} primitive(s) have no texture coordinates for their {slot} texture.",
    }
    return [sentence.format(n) for key, sentence in sentences.items() if (n := counts[key])]
