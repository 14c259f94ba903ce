"""Names of the sidecar files that are written with a model, and the references to them."""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath, PurePosixPath

from beltrami_cli.formats.changes import Bytes, Naming, NewImages, Written
from beltrami_cli.formats.image.file_formats import format_of_suffix
from beltrami_cli.formats.sidecars.model_folder import is_outside
from beltrami_cli.formats.sidecars.tile_names import has_token, tile_name, token_in
from beltrami_cli.surface.records import ImageFile, Slot
from beltrami_cli.surface.tiling import Tile

_MODEL_FOLDER = PurePosixPath()
_NOT_COPIED = "lies outside the model's folder; the output names it as the input does, and it is not copied."

_LONGEST = 255  # bytes of a file name on common file systems


def stale_use_notice(what: str, image: str) -> str:
    """Return the notice that something outside of the slots shows an image, and does not follow its new colours."""
    return f"{what} shows {image}, too, and keeps the old one: it may not be a colour."


class NewFiles:
    """Names the sidecar files of one output, each once, and collects them."""

    def __init__(self, naming: Naming, source: str, present: Iterable[str], missing: Iterable[str]) -> None:
        """`source`: name of the model; `present` and `missing`: the files that it refers to."""
        self.is_moved = naming.is_moved
        self.notices: dict[str, None] = {}  # on files outside of the folder, and old images that stay in use
        self.sidecars: dict[str, Bytes] = {}  # as in `Written`
        self.copies: dict[str, str] = {}  # as `Written.copies`
        self._naming, self._source = naming, PurePath(source).stem
        # In another folder present files are renamed, and references to missing files stay.
        self._taken = {path.casefold() for path in (*missing, *(() if naming.is_moved else present))}

    def image(
        self, path: str, suffix: str | None = None, *, is_replaced: bool = True, tiles: Iterable[Tile] = ()
    ) -> str:
        """Return the new path of an image or tile set; `is_replaced`: nothing shows the old one any more."""
        in_place = self._naming.in_place and is_replaced
        new = path_inside(path)
        if not in_place:
            new = _renamed(new, self._source, self._naming.stem)
        if suffix is not None:
            new = _with_suffix(new, suffix)
        return self._reserve(new, may_stay=in_place and new == path, tiles=tuple(tiles))

    def other(self, path: str, suffix: str) -> str:
        """Return the new path of a file that is not an image."""
        if self._naming.in_place and not is_outside(path):
            return self._reserve(path, may_stay=True)
        return self.new(suffix, PurePosixPath(path_inside(path)).parent)

    def new(self, suffix: str, folder: PurePosixPath = _MODEL_FOLDER) -> str:
        """Return the path of a file that replaces none: the stem with a suffix."""
        return self._reserve(str(folder / (self._naming.stem + suffix)))

    def leave(self, name: str) -> None:
        """Leave a file outside of the folder in place; the output refers to it as before."""
        if self.is_moved:
            self.notices[f"'{name}' {_NOT_COPIED}"] = None

    def note_stale_use(self, what: str, path: str) -> None:
        """Say that something goes on to show the old one of an image that is replaced."""
        self.notices[stale_use_notice(what, path)] = None

    def written(self, main: Sequence[Bytes] = (), notices: Iterable[str] = ()) -> Written:
        """Return the collected files, with a main file if it is given."""
        return Written(main, self.sidecars, (*notices, *self.notices), self.copies)

    def _reserve(self, path: str, *, may_stay: bool = False, tiles: tuple[Tile, ...] = ()) -> str:
        whole, number = PurePosixPath(path), 2
        token = token_in(whole.name)
        end = whole.name.rfind(token) if token and token in whole.name else len(whole.stem)
        while True:
            files = [tile_name(path, tile) for tile in tiles] or [path]
            if may_stay or not any(f.casefold() in self._taken or self._naming.is_taken(f) for f in files):
                break
            path = str(whole.with_name(f"{whole.name[:end]}-{number}{whole.name[end:]}"))
            number += 1
        self._taken.update(file.casefold() for file in files)
        return path


@dataclass(frozen=True)
class Replacement:
    """New files of an image or tile set, and all slots that show them in its place."""

    path: str  # of the image or tile set
    files: Mapping[str, ImageFile]  # by the paths of the old ones
    slots: Sequence[Slot]


def replacements(images: NewImages, paths_of: Callable[[Slot, str], Iterable[str]]) -> list[Replacement]:
    """Group new images by what they replace; `paths_of`: the images and tile sets that a file is part of in a slot."""
    files: dict[tuple[str, Slot], list[tuple[str, ImageFile]]] = {}
    for (slot, file), image in images.items():
        for path in paths_of(slot, file):
            files.setdefault((path, slot), []).append((file, image))
    slots: dict[tuple[str, tuple[tuple[str, ImageFile], ...]], list[Slot]] = {}
    for (path, slot), new in files.items():
        slots.setdefault((path, tuple(new)), []).append(slot)
    return [Replacement(path, dict(new), shown) for (path, new), shown in slots.items()]


def new_paths(path: str, new: str, tiles: Mapping[Tile, str]) -> dict[str, str]:
    """Return the new path of each file of an image or tile set."""
    if not tiles:
        return {path: new}
    return {file: file if path == new else tile_name(new, tile) for tile, file in tiles.items()}


def common_suffix(suffixes: Iterable[str]) -> str | None:
    """Return the suffix that all tiles of a set have; None if they differ."""
    distinct = set(suffixes)
    return distinct.pop() if len(distinct) == 1 else None


def path_inside(path: str) -> str:
    """Return a path, reduced to its name if it is outside of the folder, where nothing is written."""
    return PurePosixPath(path).name if is_outside(path) else path


def _renamed(path: str, source: str, stem: str) -> str:
    """Return a path with the old stem, if it occurs as a word, replaced by the new one, or else prefixed by that."""
    whole = PurePosixPath(path)
    word = rf"(?<![^\W_])(?<!<){re.escape(source)}(?![^\W_])"
    new, count = re.subn(word, lambda _: stem, whole.name, count=1)
    new = new if count else f"{stem}_{whole.name}"
    if len(os.fsencode(new)) > _LONGEST:
        new = stem + token_in(whole.name) + whole.suffix
    return str(whole.with_name(new))


def _with_suffix(path: str, suffix: str) -> str:
    """Return a path with the suffix of an image format; unchanged if it already has one of that format."""
    old = PurePosixPath(path).suffix
    if format_of_suffix(old) == format_of_suffix(suffix) or has_token(old):
        return path
    return str(PurePosixPath(path).with_suffix(suffix))


def new_reference(name: str, path: str, new: str) -> bytes:
    """Return the reference to a file that moves from `path` to `new`; the folder is spelled as in `name`."""
    if new == path:
        return os.fsencode(name)
    plain = name.replace("\\", "/")
    # Relative to some folder of the model, the name may be the path.
    if is_outside(path) or not f"/{path}".endswith(f"/{posixpath.normpath(plain)}"):
        return os.fsencode(new)
    return os.fsencode(name[: plain.rfind("/") + 1] + PurePosixPath(new).name)
