"""What is replaced in a document, and the files that come of it."""

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


@dataclass(frozen=True)
class Changes:
    """Replacements in a document; every entry that equals the present one keeps its stored bytes."""

    # Rows as in `coloured_vertices().colours`, shape (V, C); None: unchanged. They are clipped to the range of the
    # stored type and rounded to it once, to the nearest.
    colours: Float32s | None
    # By slot and `Texture.key`, of the same size in pixels: each replaces that image in that slot and nowhere else. The
    # type of file may change.
    images: NewImages = field(default_factory=dict)
    # New positions, which `require_movable` has allowed; None: unchanged. They are rounded to the stored type once.
    places: records.MovedVertices | None = None
    form: str | None = None  # one of `Document.forms`; None: that of the document
