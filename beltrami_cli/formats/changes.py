"""Records of a patch: the replacements in a document, how its sidecar files are named, and the files that result."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count

from beltrami_cli.arrays import Float32s
from beltrami_cli.surface import records

NewImages = Mapping[tuple[records.Slot, str], records.ImageFile]  # by slot and `Texture.key`
PlannedImages = Mapping[tuple[records.Slot, str], records.PlannedImage]

Bytes = bytes | bytearray | memoryview
NO_IMAGES: NewImages = {}
# Characters that references of some format cannot express, or that readers do not accept in file names.
_UNUSABLE = re.compile(r'[\x00-\x1f\x7f"\\:<>\ud800-\udfff]|^[\s.-]+|\s+$|(?<=\s)#')


@dataclass(frozen=True)
class Naming:
    """How the sidecar files of an output are named."""

    stem: str  # of the output, without folder and extension
    in_place: bool = False  # whether the output replaces the source, and its sidecar files theirs
    is_moved: bool = False  # whether the output is in another folder, and needs copies of unchanged files
    # Whether a path in the output's folder belongs to another model.
    is_taken: Callable[[str], bool] = lambda _: False

    def __post_init__(self) -> None:
        object.__setattr__(self, "stem", _UNUSABLE.sub("_", self.stem))

    def free_stem(self, sidecars: Callable[[str], Iterable[str]]) -> str:
        """Return the stem, with a number from 2 on if sidecar files of that name belong to another model."""
        stems = chain([self.stem], (f"{self.stem}-{number}" for number in count(2)))
        return next(stem for stem in stems if not any(self.is_taken(name) for name in sidecars(stem)))


@dataclass(frozen=True)
class Written:
    """The files of a document with new colours, or of a mesh converted to another format."""

    main: Sequence[Bytes]  # pieces of the main file, in their order
    # New or changed sidecar files, by path relative to the main file.
    sidecars: Mapping[str, Bytes] = field(default_factory=dict)
    # One sentence each for the user, on losses and rounding.
    notices: tuple[str, ...] = ()
    # Unchanged sidecar files: paths in the source, by new path relative to the main file.
    copies: Mapping[str, str] = field(default_factory=dict)

    @property
    def sidecar_names(self) -> list[str]:
        return [*self.sidecars, *self.copies]


@dataclass(frozen=True)
class Changes:
    """Replacements in a document; values that equal the present ones keep their stored bytes."""

    # Rows as in `coloured_vertices().colours`, shape (V, C); None: unchanged. They are clipped to the range of the
    # stored type and rounded to it once, to the nearest.
    colours: Float32s | None
    # By slot and `Texture.key`; each replaces an image of the same size in that slot only. The file type may differ.
    images: NewImages = field(default_factory=dict)
    # New positions if `require_movable` allows it; None: unchanged. They are rounded once to the stored type.
    places: records.MovedVertices | None = None
    form: str | None = None  # one of `Document.forms`; None: that of the document
