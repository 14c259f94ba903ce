"""What every model format implements: a document that keeps its bytes and lets only its colours be replaced.

A format is a subclass of `Document`, in a folder of its own, and a line of `formats/registry.py`. To write one:

- The constructor takes the bytes, the name for messages, the folder of sidecar files (None: there are none, as for
  standard input) and the `Access`, and calls `_open` with the folder. Files may be parsed lazily, and every count is
  held against the length of the data before anything is allocated.
- `_mesh` (or `_coloured_vertices` and `contents`), `_patched` and `facts` are required; the others have defaults for a
  format without textures, sidecar files, range images, further attributes or movable vertices. With textures, `slots`,
  `textured_mesh` and `_scene` are required, too: `scene_surface.py` and `scene_mesh.py` in `formats/meshes/` make
  surfaces and meshes of a `Scene`.
- `notices` and `obstacles` concern the file; records have notices of their own on how they were read.
- `patch` with equal colours returns equal bytes. What changes is rounded once; every other byte stays.
- Whatever is wrong with the file is an `InputError` with its name, the cause and a remedy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, NoColoursError, Obstacle
from beltrami_cli.formats.changes import NO_IMAGES, Changes, Naming, NewImages, PlannedImages, Written
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access
from beltrami_cli.formats.fingerprint import Fingerprint
from beltrami_cli.formats.full_scale import BYTE, holds_bytes
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import KeptImage
from beltrami_cli.formats.meshes.scene import Scene
from beltrami_cli.formats.meshes.scene_surface import textured_surface
from beltrami_cli.surface import records
from beltrami_cli.surface.polygons import triangulate
from beltrami_cli.surface.records import ColouredVertices


class Document(ABC):
    """An opened file. It is never changed: `patch` makes new bytes."""

    format: str
    """The name of its line in the registry."""

    kind = "model"
    """What it holds: a "model", an "image", or a "volume"."""

    forms: tuple[str, ...] = ()
    """Formats in which `patch` can write it with all that it holds."""

    def __init__(
        self, data: bytes, name: str, folder: Path | None = None, access: Access = DEFAULT_ACCESS
    ) -> None:
        self.data, self.access = data, access
        self.name = name  # of the file as the user named it, for messages
        self._textured: dict[records.Slot, records.TexturedSurface] = {}
        self._open(folder)

    def _open(self, folder: Path | None) -> None:
        """Read what must be sound in every file of the format."""
        del folder  # for formats with sidecar files

    @property
    def notices(self) -> tuple[str, ...]:
        """What users should know of the file, whichever part they use: one sentence each, without its name."""
        return ()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Why colours are not used; `notices` has them, too."""
        return ()

    @abstractmethod
    def facts(self) -> dict[str, object]:
        """Return facts about the file for `beltrami info`, in JSON types, in the order to be shown."""

    # Vertices with colours

    def coloured_vertices(self) -> ColouredVertices:
        """Return the vertex colours and their surface, always the same record; InputError without usable ones."""
        try:
            return self._coloured_vertices
        except NoColoursError as error:
            if not self.slots():
                raise
            remedy = "smooth these, or move them into vertices by beltrami bake --to vertices"
            raise NoColoursError(self.name, "it has textures, but no vertex colours", remedy) from error

    def has_vertex_colours(self) -> bool:
        """Whether `coloured_vertices` has anything to return, without checking all of it."""
        try:
            self.coloured_vertices()
        except InputError:
            return False
        return True

    @cached_property
    def _coloured_vertices(self) -> ColouredVertices:
        mesh = self._mesh
        faces = triangulate(mesh.positions, mesh.corners, mesh.offsets)
        return ColouredVertices(
            mesh.positions, faces, mesh.colours, self._channels, mesh.encoding, mesh.stored,
            assumed_scale=self._scale, notices=mesh.notices,
        )  # fmt: skip

    @property
    def _mesh(self) -> records.MeshContents:
        """The polygons and their colours, with whatever else of `contents` costs nothing."""
        raise NotImplementedError

    @property
    def _channels(self) -> tuple[str, ...]:
        return ("red", "green", "blue")

    @property
    def _scale(self) -> float | None:
        """The number that is full scale of the vertex colours; None: as their type says."""
        return None

    @property
    def frame(self) -> records.Frame:
        """Which axis of the positions is up, and their unit."""
        return records.Frame()

    def hidden_places(self) -> tuple[str, ...]:
        """Describe the places of a mesh that `coloured_vertices` and `textured` skip, if there are any."""
        return ()

    def grid(self) -> Int64s | None:
        """Return the rows of `coloured_vertices()` on a range image's grid, (H, W), -1: none; None without a grid."""
        return None

    def attributes(self) -> tuple[str, ...]:
        """Return the names of what vertices have besides positions and colours; "normal" if they have normals."""
        return ()

    def attribute(self, name: str) -> Float64s:
        """Return an attribute, (V, G), with rows as in `coloured_vertices().colours`; InputError if there is none.

        The name is one of `attributes()`, in any case of letters. Integers are divided by their full scale only where
        the format says that they are fractions. Normals are of unit length or 0, in the space of the positions.
        """
        fits = [known for known in self.attributes() if known.lower() == name.lower()]
        if name in fits:
            return self._attribute(name)
        if not fits:
            known = ", ".join(self.attributes()) or "nothing"
            raise InputError(self.name, f"its vertices have no {name}, but {known} besides colours")
        return self._attribute(fits[0])

    def _attribute(self, name: str) -> Float64s:
        raise NotImplementedError

    # Textures, and the image of an image file

    def slots(self) -> tuple[records.Slot, ...]:
        """Return the material slots that have textures, the base colour first."""
        return ()

    def textured(self, slot: records.Slot) -> records.TexturedSurface:
        """Return the textures of a slot and their surface, always the same record; InputError without usable ones."""
        if slot not in self._textured:
            surface = self._gathered(slot)
            textures = tuple(replace(texture, model=self.name) for texture in surface.textures)
            self._textured[slot] = replace(surface, textures=textures)
        return self._textured[slot]

    def readable(self, slots: Iterable[records.Slot]) -> tuple[records.Slot, ...]:
        """Leave out slots whose images are missing, if there is something else that is coloured."""
        slots, found = tuple(slots), []
        for slot in slots:
            with suppress(NoColoursError):
                self.textured(slot)
                found.append(slot)
        return tuple(found) if found or self.has_vertex_colours() else slots

    def _gathered(self, slot: records.Slot) -> records.TexturedSurface:
        return textured_surface(self._scene, slot, self._why_untextured())

    @property
    def _scene(self) -> Scene:
        """Its polygons and materials; InputError if it has no textures."""
        raise InputError(self.name, "it has no textures")

    def _why_untextured(self) -> Obstacle | None:
        """Return why polygons may have no texture besides missing images; None if nothing is known."""
        return None

    def image(self) -> DecodedImage:
        """Return the image that it holds, always the same record; InputError if it is none."""
        raise InputError(self.name, "it is a model, and no image")

    # The file with new colours

    def patch(
        self,
        colours: Float32s | None,
        naming: Naming,
        *,
        images: NewImages = NO_IMAGES,
        places: records.MovedVertices | None = None,
        form: str | None = None,
    ) -> Written:
        """Return the document's files with other colours, images or positions, and everything else as it was."""
        return self._patched(Changes(colours, images, places, form), naming)

    @abstractmethod
    def _patched(self, new: Changes, naming: Naming) -> Written: ...

    def sidecar_names(
        self, images: PlannedImages, naming: Naming, *, colours: bool, places: bool = False, form: str | None = None
    ) -> list[str]:  # fmt: skip
        """Return which sidecar files `patch` can write for these images, and if all colours or positions change."""
        del images, naming, colours, places, form  # for formats whose documents are one file
        return []

    def references(self) -> Sequence[str]:
        """Return relative paths of existing unchanged files that the model refers to ("/" separates)."""
        return ()

    def require_movable(self) -> None:
        """Raise InputError if `patch` cannot take new positions: the format or their storage does not allow it."""
        raise InputError(self.name, f"the positions of a {self.format} file cannot be replaced")

    def has_normals_by_vertex(self) -> bool:
        """Whether `patch` puts normals into the document when vertices move."""
        return "normal" in self.attributes()

    # Meshes for other formats

    def contents(self) -> records.MeshContents:
        """Return the mesh of the coloured vertices as the file has it; InputError as `coloured_vertices`."""
        return self._mesh

    def colours_at_vertices(self, colours: Float32s) -> Float32s:
        """Return colours, rows as in `patch`, with rows as in `contents`: others if the colours are of faces."""
        return colours

    def vertex_mesh(self, colours: Float32s | None = None) -> records.MeshContents:
        """Return the mesh of the coloured vertices for another format; `colours` as in `patch`."""
        mesh, shown = self.contents(), self.coloured_vertices()
        # Where the stored type does not determine the one in another format, the colours do.
        says_little = mesh.stored == "text" or shown.assumed_scale == BYTE
        are_bytes = (
            says_little and holds_bytes(shown.colours) and (mesh.alpha is None or holds_bytes(mesh.alpha))
        )
        return replace(
            mesh,
            colours=mesh.colours if colours is None else self.colours_at_vertices(colours),
            stored="uint8" if are_bytes else mesh.stored,
        )

    def textured_mesh(self, colours: Float32s | None = None) -> records.MeshContents:
        """Return all polygons with materials and images for another format; `colours` as in `patch`."""
        raise InputError(self.name, f"the textures of a {self.format} file cannot be converted")

    def _with_vertex_colours(
        self, mesh: records.MeshContents, colours: Float32s | None
    ) -> records.MeshContents:
        """Add vertex colours, as in `patch`, to a textured mesh if both have the same vertices."""
        if not self.has_vertex_colours():
            return mesh
        shown = self.vertex_mesh(colours)
        mesh = replace(mesh, notices=(*mesh.notices, *shown.notices))
        if not np.array_equal(shown.positions, mesh.positions):
            lost = "vertex colours, which are not one for each vertex"
            return replace(mesh, left_out=(*mesh.left_out, lost))
        return replace(
            mesh, colours=shown.colours, alpha=shown.alpha, encoding=shown.encoding, stored=shown.stored
        )

    # Copies to look at, and comparison

    def with_colours(
        self, vertices: ColouredVertices | None, images: Mapping[tuple[records.Slot, str], bytes]
    ) -> Self:
        """Return a copy to look at, but not to patch, with other vertex colours (None: the same) and image files."""
        surfaces = {slot: self.textured(slot) for slot, _ in images}
        for slot, surface in surfaces.items():
            contents = (images.get((slot, each.key), each.content) for each in surface.textures)
            surfaces[slot] = _with_contents(surface, contents)
        return self._showing(surfaces, vertices)

    def keeping_images(self) -> Self:
        """Return the same document, which decodes each texture only once, for work on it again and again."""
        surfaces = {slot: self.textured(slot) for slot in self.readable(self.slots())}
        for slot, surface in surfaces.items():
            surfaces[slot] = _with_contents(surface, map(KeptImage, surface.textures))
        return self._showing(surfaces)

    def _showing(
        self,
        surfaces: Mapping[records.Slot, records.TexturedSurface],
        vertices: ColouredVertices | None = None,
    ) -> Self:
        made = copy(self)
        made._textured = {**self._textured, **surfaces}
        if vertices is not None:
            made._coloured_vertices = vertices  # in place of what the property would cache
        return made

    def access_to_copies(self) -> Access:
        """Return how to open copies with other colours, so that these are found where they are here."""
        return self.access

    def fingerprint(self) -> Fingerprint:
        """Take the file apart for comparison with another; InputError if that is not possible or it is damaged."""
        raise InputError(self.name, f"a {self.format} file cannot be compared with another")


def _with_contents(
    surface: records.TexturedSurface, contents: Iterable[bytes | Callable[[], bytes]]
) -> records.TexturedSurface:
    pairs = zip(surface.textures, contents, strict=True)
    return replace(surface, textures=tuple(replace(each, content=content) for each, content in pairs))
