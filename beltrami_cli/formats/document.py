"""What every model format implements: a document that keeps its bytes and lets only its colours be replaced.

A format is a subclass of `Document`, in a folder of its own, and a line of `formats/registry.py`. To write one:

- The constructor takes the bytes, the name for messages, the folder of sidecar files (None: there are none, as for
  standard input) and the `Access`, and calls `_open` with the folder. Files may be parsed lazily, and every count is
  held against the length of the data before anything is allocated.
- `_mesh` (or `_painted` and `contents`), `_patched` and `facts` are required; the others have defaults for a format
  without textures, sidecar files, range images, further attributes or movable vertices. With textures, `slots` and
  `_scene` are required, too: a `Scene` of `formats/textured_mesh.py`, which makes their surfaces and meshes.
- `patch` with equal colours returns equal bytes. What changes is rounded once; every other byte stays.
- Whatever is wrong with the file is an `InputError` with its name, the cause and a remedy.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, count
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Self

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.colours import BYTE, holds_bytes
from beltrami_cli.formats.image import Picture, read_image
from beltrami_cli.surface import records
from beltrami_cli.surface.geometry import triangulate
from beltrami_cli.surface.records import PaintedVertices

NewImages = Mapping[tuple[records.Slot, str], records.ImageFile]  # by slot and `Texture.key`
PlannedImages = Mapping[tuple[records.Slot, str], records.PlannedImage]

Bytes = bytes | bytearray | memoryview
NO_IMAGES: NewImages = {}
# Characters that references in some format cannot spell, or that readers do not take for part of a file name.
_UNFIT = re.compile(r'[\x00-\x1f\x7f"\\:<>\ud800-\udfff]|^[\s.-]+|\s+$|(?<=\s)#')


@dataclass(frozen=True)
class Naming:
    """How the sidecar files of an output are named."""

    stem: str  # of the output, without folder and extension
    keeps: bool = False  # the output and its sidecar files replace the source's files
    copies: bool = False  # the output lies in another folder, where it needs copies of unchanged files
    # Whether a path in the output's folder belongs to another model.
    is_taken: Callable[[str], bool] = lambda _: False

    def __post_init__(self) -> None:
        object.__setattr__(self, "stem", _UNFIT.sub("_", self.stem))

    def free_stem(self, sidecars: Callable[[str], Iterable[str]]) -> str:
        """Return a stem, numbered from 2 on if need be, such that no sidecar file belongs to another model."""
        stems = chain([self.stem], (f"{self.stem}-{number}" for number in count(2)))
        return next(stem for stem in stems if not any(self.is_taken(name) for name in sidecars(stem)))


@dataclass(frozen=True)
class Written:
    """The files of a document with new colours, or of a mesh converted to another format."""

    main: Sequence[Bytes]  # pieces of the main file, in their order
    # New or changed, by path relative to the main file.
    sidecars: Mapping[str, Bytes] = field(default_factory=dict)
    # For the user, one sentence each: what the format cannot hold, what was rounded.
    notices: tuple[str, ...] = ()
    # New paths, relative to the main file, of unchanged files, by their names in the source.
    copies: Mapping[str, str] = field(default_factory=dict)

    @property
    def sidecar_names(self) -> list[str]:
        return [*self.sidecars, *self.copies]


def not_converted(
    mesh: records.MeshContents,
    others: Iterable[str] = (),
    *,
    keeps_frame: bool = False,
) -> list[str]:
    """Return the notice of what a conversion drops, or nothing."""
    left = dict.fromkeys([*mesh.left_out, *others])
    if mesh.frame.up != "Y" and not keeps_frame:
        left |= {f"the axis that is up, which is {mesh.frame.up}": None}
    if mesh.frame.unit != 1 and not keeps_frame:
        left |= {f"the unit of {mesh.frame.unit:g} m": None}
    return [f"Not converted: {'; '.join(left)}."] if left else []


@dataclass(frozen=True)
class Changes:
    """Replacements in a document; every entry that equals the present one keeps its stored bytes."""

    # Rows as in `painted().colours`, shape (V, C); None: unchanged. They are clipped to the range of the stored type
    # and rounded to it once, to the nearest.
    colours: Float32s | None
    # By slot and `Texture.key`, of the same size in pixels: each replaces that image in that slot and nowhere else. The
    # type of file may change.
    images: NewImages = field(default_factory=dict)
    # New positions, which `require_movable` has allowed; None: unchanged. They are rounded to the stored type once.
    places: records.MovedVertices | None = None
    form: str | None = None  # one of `Document.forms`; None: that of the document


@dataclass(frozen=True)
class Fingerprint:
    """A file with colours and images separated from all the rest, so that two files can be compared."""

    # Neither colours nor images, by place in the file; placeholders stand for these and for names of images, so that
    # files that differ in nothing but colours have equal parts.
    parts: Mapping[str, bytes]
    colours: Mapping[str, Float32s] = field(default_factory=dict)  # full scale 1, shape (n, C)
    images: Mapping[str, records.Texture] = field(default_factory=dict)  # by where they are used
    faults: Sequence[str] = ()  # what some readers cannot do with; there may be fewer in the other file


def labelled(files: Mapping[str, str], read: Callable[[str], bytes]) -> dict[str, records.Texture]:
    """Return image files as a fingerprint has them, by where they are used."""
    return {
        label: records.Texture(file, file.rpartition("/")[2], partial(read, file))
        for label, file in files.items()
    }


class Document(ABC):
    """An opened file. It is never changed: `patch` makes new bytes."""

    format: ClassVar[str]
    """The name of its line in the registry."""

    kind: ClassVar[str] = "model"
    """What it holds: a "model", an "image", or a "volume"."""

    forms: tuple[str, ...] = ()
    """Formats in which `patch` can write it with all that it holds."""

    def __init__(
        self, data: bytes, name: str, folder: Path | None = None, access: Access = EVERYTHING_INSIDE
    ) -> None:
        self.data, self.access = data, access
        self.name = name  # of the file as the user named it, for messages
        self._textured: dict[records.Slot, records.TexturedSurface] = {}
        self.notices: list[str] = []  # for the user, one sentence each, without the file's name
        self._open(folder)

    def _open(self, folder: Path | None) -> None:
        """Read what must be sound in every file of the format."""
        del folder  # for formats with sidecar files

    def painted(self) -> PaintedVertices:
        """Return the vertex colours and their surface, always the same record; InputError without usable ones."""
        return self._painted

    @cached_property
    def _painted(self) -> PaintedVertices:
        mesh = self._mesh
        faces = triangulate(mesh.positions, mesh.corners, mesh.offsets)
        return PaintedVertices(
            mesh.positions, faces, mesh.colours, self._channels, mesh.encoding, mesh.stored,
            assumed_scale=self._scale,
        )  # fmt: skip

    @property
    def _mesh(self) -> records.MeshContents:
        """The polygons and their colours, with whatever else of `contents` costs nothing."""
        raise NotImplementedError

    @property
    def _channels(self) -> tuple[str, ...]:
        return ("red", "green", "blue")

    def picture(self) -> Picture:
        """Return the image that it holds, always the same record; InputError if it is none."""
        raise InputError(self.name, "it is a model, and no image")

    @property
    def _scale(self) -> float | None:
        """The number that is full scale of the vertex colours; None: as their type says."""
        return None

    @property
    def frame(self) -> records.Frame:
        """Which axis of the positions is up, and their unit."""
        return records.Frame()

    def hidden_places(self) -> tuple[str, ...]:
        """Return words for the places of a mesh that `painted` and `textured` do not have, if there are any."""
        return ()

    def grid(self) -> Int64s | None:
        """Return the rows of `painted()` on the grid of a range image, shape (H, W), -1: none; None without a grid."""
        return None

    def has_vertex_colours(self) -> bool:
        """Whether `painted` has anything to return, without checking all of it."""
        try:
            self.painted()
        except InputError:
            return False
        return True

    def attributes(self) -> tuple[str, ...]:
        """Return the names of what vertices have besides positions and colours; "normal" if they have normals."""
        return ()

    def attribute(self, name: str) -> Float64s:
        """Return an attribute, shape (V, G), with rows as in `painted().colours`; InputError if there is none.

        The name is one of `attributes()`, in any case of letters. Integers are divided by their full scale only where
        the format says that they are fractions. Normals are of unit length or 0, in the space of the positions.
        """
        fits = [known for known in self.attributes() if known.lower() == name.lower()]
        if not fits:
            known = ", ".join(self.attributes()) or "nothing"
            raise InputError(self.name, f"its vertices have no {name}, but {known} besides colours")
        return self._attribute(fits[0])

    def _attribute(self, name: str) -> Float64s:
        raise NotImplementedError

    def access_to_copies(self) -> Access:
        """Return how to open copies with other colours, so that these are found where they are here."""
        return self.access

    def has_normals_by_vertex(self) -> bool:
        """Whether `patch` puts normals into the document when vertices move."""
        return "normal" in self.attributes()

    def require_movable(self) -> None:
        """Raise InputError if `patch` cannot take new positions: the format or their storage does not allow it."""
        raise InputError(self.name, f"the positions of a {self.format} file cannot be replaced")

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
            with suppress(UnpaintedError):
                self.textured(slot)
                found.append(slot)
        return tuple(found) if found or self.has_vertex_colours() else slots

    def _gathered(self, slot: records.Slot) -> records.TexturedSurface:
        surface: records.TexturedSurface
        surface, notices = self._scene.surface(slot, self._undefined())
        self.notices += notices
        return surface

    @property
    def _scene(self) -> Any:
        """Its polygons and materials, a `Scene`; InputError if it has no textures."""
        raise InputError(self.name, "it has no textures")

    def _undefined(self) -> str:
        """Return why a material may have no textures that can be known, or nothing."""
        return ""

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

    def contents(self) -> records.MeshContents:
        """Return the mesh for conversion to another format; InputError as `painted`."""
        return self._mesh

    def recoloured_contents(self, colours: Float32s | None) -> records.MeshContents:
        """Return `contents` with other colours, rows as in `patch`; None: the present ones."""
        contents = self.contents()
        stored = self._type_of(contents.colours, contents.alpha, contents.stored)
        return replace(contents, colours=contents.colours if colours is None else colours, stored=stored)

    def _type_of(self, colours: Float32s, alpha: Float32s | None, stored: str) -> str:
        """Return the type that another format needs for the present colours, where the stored one says little."""
        says_little = stored == "text" or self._scale == BYTE
        are_bytes = says_little and holds_bytes(colours) and (alpha is None or holds_bytes(alpha))
        return "uint8" if are_bytes else stored

    def textured_mesh(self, colours: Float32s | None = None) -> records.MeshContents:
        """Return all polygons with materials and images, for conversion; `colours` as in `patch`."""
        mesh = self._textured_mesh()
        if not self.has_vertex_colours():
            return mesh
        shown = self.recoloured_contents(colours)
        if not np.array_equal(shown.positions, mesh.positions):
            lost = "vertex colours, which are not one for each vertex"
            return replace(mesh, left_out=(*mesh.left_out, lost))
        coding: dict[str, Any] = {"encoding": shown.encoding, "stored": shown.stored}
        return replace(mesh, colours=shown.colours, alpha=shown.alpha, **coding)

    def _textured_mesh(self) -> records.MeshContents:
        """Return what `textured_mesh` does, without colours of vertices."""
        raise InputError(self.name, f"the textures of a {self.format} file cannot be converted")

    def repainted(
        self, vertices: PaintedVertices | None, images: Mapping[tuple[records.Slot, str], bytes]
    ) -> Self:
        """Return a copy to look at, but not to patch, with other vertex colours (None: the same) and image files."""
        made = copy(self)
        made.notices, made._textured = [], {}
        if vertices is not None:
            made._painted = vertices  # in place of what the property would cache
        for slot in dict.fromkeys(slot for slot, _ in images):
            surface = self.textured(slot)
            made._textured[slot] = replace(
                surface,
                textures=tuple(
                    replace(each, content=images.get((slot, each.key), each.content))
                    for each in surface.textures
                ),
            )
        return made

    def fingerprint(self) -> Fingerprint:
        """Take the file apart for comparison with another; InputError if that is not possible or it is damaged."""
        raise InputError(self.name, f"a {self.format} file cannot be compared with another")

    @abstractmethod
    def facts(self) -> dict[str, object]:
        """Return facts about the file for `beltrami info`, in JSON types, in the order to be shown."""


class ImageDocument(Document):
    """An image, which is decoded when its picture is asked for."""

    format: ClassVar[str] = "image"
    kind: ClassVar[str] = "image"

    @cached_property
    def _picture(self) -> Picture:
        return read_image(self.data, self.name, finite=False)

    def picture(self) -> Picture:
        return self._picture

    @property
    def _mesh(self) -> NoReturn:
        raise InputError(self.name, "it is an image, and no model")

    def facts(self) -> dict[str, object]:
        return {"format": self._picture.format, "bytes": len(self.data)}

    def _patched(self, new: Changes, naming: Naming) -> Written:
        return Written([image.content for image in new.images.values()] or [self.data])
