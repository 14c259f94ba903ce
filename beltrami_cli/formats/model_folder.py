"""Files that a model refers to: which names are followed, where they lead, and the names of new files.

The name of a set of tiles has a token, in whose place the files have the number of the tile at column u and row v:

| token | numbering | tile (2, 1) |
|---|---|---|
| `<UDIM>` | Mari: 1001 + u + 10 v, with u below 10 | 1013 |
| `<UVTILE>` | Mudbox: both counted from 1 | u3_v2 |
| `<uvtile>` | ZBrush: both counted from 0 | u2_v1 |
"""

from __future__ import annotations

import contextlib
import os
import posixpath
import re
import stat
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path, PurePosixPath, PureWindowsPath

from beltrami_cli.errors import InputError, Obstacle
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_regular
from beltrami_cli.formats.changes import Bytes, Naming, NewImages, Written
from beltrami_cli.formats.image.file_formats import format_of_suffix
from beltrami_cli.surface.records import ImageFile, Slot
from beltrami_cli.surface.tiling import COLUMNS, ROWS, Tile

_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)  # a URL, or the letter of a drive
_NETWORK = re.compile(r"[a-z][a-z0-9+.-]+:|//", re.IGNORECASE)
_HERE = PurePosixPath()
_ENCODINGS = ("gbk", "cp932", "cp1252")  # in China, in Japan and in the West
_MISSING, _TILES = "is missing", "stands for a set of tiles (UDIM), which are not read"
_NOWHERE = "is a file in the folder of the model, which is not known"
_KEEP_TOGETHER = "keep the model's files together, under the names that it has for them"
_TILE_BY_TILE = "give each tile a material and a name of its own"
_AS_A_FILE = "give the model as a file, not through a pipe"
_COPY_INSIDE = (
    "copy its files into the model's folder; for other formats than USD, --allow-outside reads them as well"
)

_TOKEN = re.compile(r"<(udim|UDIM|UVTILE|uvtile)>")
_FIRST = 1001

LEFT_ALONE = ", and is left alone."  # behind the cause why a file is not read
_STAYS = "lies outside the model's folder; the output names it as the input does, and it is not copied."


class UnfitReferenceError(Exception):
    """A name that is not followed; the message is the cause, to be put behind the name."""

    def __init__(self, cause: str, remedy: str = "") -> None:
        super().__init__(cause)
        self.obstacle = Obstacle(cause, remedy)


class ModelFolder:
    """The folder of a model (None: it has none), which no name leaves unless the access allows it."""

    def __init__(self, folder: Path | None, access: Access = EVERYTHING_INSIDE) -> None:
        self._folder = None if folder is None else folder.resolve()
        self._known: dict[tuple[str, PurePosixPath], str | Obstacle] = {}
        self._listings: dict[Path, dict[str, str]] = {}
        self.tiles: dict[str, dict[Tile, str]] = {}  # files of the sets that were located, by the set's path
        self.access = access

    def find(self, name: str) -> str | None:
        try:
            return self.locate(name)
        except UnfitReferenceError:
            return None

    def locate(self, name: str, within: PurePosixPath = _HERE) -> str:
        """Return the path of a regular file, relative to the folder; UnfitReferenceError if there is none."""
        key = name, within
        if key not in self._known:  # A hostile file names the same one a million times.
            try:
                self._known[key] = self._locate(name, within)
            except UnfitReferenceError as error:
                self._known[key] = error.obstacle
        found = self._known[key]
        if isinstance(found, str):
            return found
        raise UnfitReferenceError(*found)

    def _locate(self, name: str, within: PurePosixPath) -> str:
        path = checked_path(name, within, outside=self.access.outside)
        if self._folder is None:
            raise UnfitReferenceError(_NOWHERE, _AS_A_FILE)
        if self.access.bring is not None:
            self.access.bring(self._folder / path)
        try:
            is_file = stat.S_ISREG(self.access.found_at(self._folder / path).stat().st_mode)
            there = (self._folder / path).resolve()
        except (FileNotFoundError, NotADirectoryError):
            similar = None if is_outside(path) else self._like_named(path)
            hint = f" (there is '{similar}', but capitals and accents count)" if similar else ""
            raise UnfitReferenceError(f"{_MISSING}{hint}", _KEEP_TOGETHER) from None
        except (OSError, ValueError, RuntimeError):  # Names that no file can have: too long, or with a NUL.
            raise UnfitReferenceError("cannot be the name of a file") from None
        if not self.access.outside and not there.is_relative_to(self._folder):
            raise UnfitReferenceError("leads out of the model's folder; only files inside it are read")
        if not is_file:
            raise UnfitReferenceError("is not a regular file")
        if is_outside(path) and there.is_relative_to(self._folder):  # out, and in again
            return there.relative_to(self._folder).as_posix()
        return path

    def locate_alike(
        self, name: str, within: PurePosixPath = _HERE, *, tiles: bool = True
    ) -> tuple[str, str]:
        """Return the path of a file (`tiles`: or a set of tiles) that a name means, and what to say behind it, or "".

        Exporters write the paths of their own machine, and names in the encoding of its language.
        """
        locate = self.locate_any if tiles else self.locate
        try:
            return locate(name, within), ""
        except UnfitReferenceError as error:
            failed = error
        for spelling in _spellings(name):
            last = PureWindowsPath(spelling).name
            for known, folder in ((spelling, within), (last, within), (last, _HERE)):
                with contextlib.suppress(UnfitReferenceError):
                    path = locate(known, folder)
                    return path, f"is not followed; '{path}' in the model's folder is taken for it."
        raise failed

    def locate_any(self, pattern: str, within: PurePosixPath = _HERE) -> str:
        """Return the path of a file, or of a set of tiles; UnfitReferenceError if it is not there."""
        if not has_token(pattern):
            return self.locate(pattern, within)
        path = checked_path(pattern, within, outside=self.access.outside, tiles=True)
        if self._folder is None:
            raise UnfitReferenceError(_NOWHERE, _AS_A_FILE)
        folder = PurePosixPath(path).parent
        if self.access.bring is not None:
            # The hundred tiles that a set has at most in practice, for storage that is not listed.
            for u, v in product(range(COLUMNS), range(10)):
                self.access.bring(self._folder / folder / tile_name(PurePosixPath(path).name, (u, v)))
        names = {*self._names_in(self._folder / folder).values()}
        names |= {there.name for there in self.access.instead if there.parent == self._folder / folder}
        tiles = found_tiles(PurePosixPath(path).name, names)
        if not tiles:
            raise UnfitReferenceError(f"{_MISSING} (no tile of it is there)", _KEEP_TOGETHER)
        self.tiles[path] = {tile: self.locate(str(folder / name)) for tile, name in tiles.items()}
        return path

    def files(self, path: str) -> list[str]:
        """Return the file of a path, or all files of a set of tiles."""
        return list(self.tiles[path].values()) if path in self.tiles else [path]

    def _like_named(self, path: str) -> str | None:
        """Return a file whose path differs only in capitals, or in how accents are coded."""
        assert self._folder is not None
        found = PurePosixPath()
        for part in PurePosixPath(path).parts:
            name = self._names_in(self._folder / found).get(_case_folded(part))
            if name is None:
                return None
            found /= name
        return found.as_posix()

    def _names_in(self, folder: Path) -> dict[str, str]:
        """Return the names in a folder inside the model's, by their case-folded form."""
        if folder not in self._listings:
            names: list[str] = []
            inside = self._folder is not None and folder.resolve().is_relative_to(self._folder)
            if inside or self.access.outside:
                with contextlib.suppress(OSError):
                    names = [entry.name for entry in folder.iterdir()]
            self._listings[folder] = {_case_folded(name): name for name in names}
        return self._listings[folder]

    def read(self, path: str, most: int = -1) -> bytes:
        """Return the content of a located file, or its first `most` bytes; OSError if it cannot be read."""
        if self._folder is None:
            raise FileNotFoundError(path)
        return read_regular(self._folder / path, self.access, most)

    def content(self, path: str) -> bytes:
        """Return the content of a located file; InputError if it has become unreadable."""
        try:
            return self.read(path)
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})") from error


def _spellings(name: str) -> list[str]:
    """Return a name, or of one that is no UTF-8 what it is in the encodings of Windows programs."""
    octets, spellings = os.fsencode(name), []
    for encoding in ("utf-8", *_ENCODINGS):
        with contextlib.suppress(UnicodeDecodeError):
            spellings.append(octets.decode(encoding))
            if encoding == "utf-8":
                break
    return spellings


def _case_folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def checked_path(name: str, within: PurePosixPath = _HERE, *, outside: bool, tiles: bool = False) -> str:
    """Return the path that a name stands for, as `ModelFolder.locate` does, but without looking at the disk."""
    plain = name.replace("\\", "/")
    if not name:
        raise UnfitReferenceError("is empty")
    if _NETWORK.match(plain) or (_SCHEME.match(plain) and not outside):
        raise UnfitReferenceError("is not a relative path; only files in the model's folder are read")
    if has_token(name) and not tiles:
        raise UnfitReferenceError(_TILES, _TILE_BY_TILE)
    path = within / plain
    if any(part.startswith(".") and part != ".." for part in path.parts):
        raise UnfitReferenceError("is a hidden file, which is not read")
    if not outside and (path.is_absolute() or ".." in path.parts):
        raise UnfitReferenceError("leaves the model's folder; only files inside it are read", _COPY_INSIDE)
    return posixpath.normpath(path) if outside else str(path)


def is_outside(path: str) -> bool:
    """Whether a located path leads out of the model's folder."""
    return path.startswith(("/", "../")) or path == ".." or bool(_SCHEME.match(path))


def has_token(name: str) -> bool:
    """Whether a name stands for a set of tiles."""
    return _TOKEN.search(name) is not None


def token_in(name: str) -> str:
    """Return what stands for the number of a tile in a name, with a dot in front; "" if nothing does."""
    token = _TOKEN.search(name)
    return f".{token[0]}" if token else ""


def tile_name(pattern: str, tile: Tile) -> str:
    """Return the name of a tile's file."""

    def number(token: re.Match[str]) -> str:
        if token[1].lower() == "udim":
            return str(_FIRST + tile[0] + COLUMNS * tile[1])
        first = int(token[1] == "UVTILE")
        return f"u{tile[0] + first}_v{tile[1] + first}"

    return _TOKEN.sub(number, pattern, count=1)


def found_tiles(pattern: str, names: Iterable[str]) -> dict[Tile, str]:
    """Return the tiles of a set among the names of a folder, row by row from below."""
    token = _TOKEN.search(pattern)
    assert token is not None
    is_mari, first = token[1].lower() == "udim", int(token[1] == "UVTILE")
    label = r"([1-9]\d{3})" if is_mari else r"[uU](\d{1,3})_[vV](\d{1,3})"
    name_of = re.compile(re.escape(pattern[: token.start()]) + label + re.escape(pattern[token.end() :]))
    found: dict[Tile, str] = {}
    for match in filter(None, map(name_of.fullmatch, sorted(names))):
        u, v = int(match[1]) - first, int(match[match.re.groups]) - first
        if is_mari:
            v, u = divmod(u - _FIRST, COLUMNS)
        if 0 <= u < COLUMNS and 0 <= v < ROWS:
            found[u, v] = match[0]
    return dict(sorted(found.items(), key=lambda item: item[0][::-1]))


TileSets = Mapping[str, Mapping[Tile, str]]  # the files of sets of tiles, by the path of the set
SlotsByPath = dict[tuple[str, tuple[tuple[str, ImageFile], ...]], list[Slot]]
_LONGEST = 255  # bytes of a name, on all usual file systems


def still_shown(what: str, image: str) -> str:
    """Return the notice that something outside of the slots shows an image, and does not follow its new colours."""
    return f"{what} shows {image}, too, and keeps the old one: it may not be a colour."


class NewFiles:
    """Names the sidecar files of one output, each once, and collects them."""

    def __init__(self, naming: Naming, source: str, present: Iterable[str], missing: Iterable[str]) -> None:
        """`source` is the model's own name; `present` and `missing` are the files that it refers to."""
        self.copies = naming.copies
        self.notices: dict[
            str, None
        ] = {}  # of files that stay where they are, and of old images that stay in use
        self.sidecars: dict[str, Bytes] = {}  # and copies, as in `Written`
        self.copied: dict[str, str] = {}
        self._naming, self._source = naming, Path(source).stem
        # In another folder present files get other names, and references to missing files stay.
        self._taken = {path.casefold() for path in (*missing, *(() if naming.copies else present))}

    def image(
        self, path: str, suffix: str | None = None, *, is_replaced: bool = True, tiles: Iterable[Tile] = ()
    ) -> str:
        """Return the path of an image, or a set of tiles, in place of another that nothing shows if `is_replaced`."""
        keeps = self._naming.keeps and is_replaced
        new = path_inside(path)
        if not keeps:
            new = _renamed(new, self._source, self._naming.stem)
        if suffix is not None:
            new = _with_suffix(new, suffix)
        return self._reserve(new, may_stay=keeps and new == path, tiles=tuple(tiles))

    def other(self, path: str, suffix: str) -> str:
        """Return the path of a file that is no image, in place of another."""
        if self._naming.keeps and not is_outside(path):
            return self._reserve(path, may_stay=True)
        return self.new(suffix, PurePosixPath(path_inside(path)).parent)

    def new(self, suffix: str, folder: PurePosixPath = _HERE) -> str:
        """Return the path of a file that replaces none: the stem with a suffix."""
        return self._reserve(str(folder / (self._naming.stem + suffix)))

    def leave(self, name: str) -> None:
        """Leave a file outside the folder where it is, and have the output name it as before."""
        if self.copies:
            self.notices[f"'{name}' {_STAYS}"] = None

    def keep_shown(self, what: str, path: str) -> None:
        """Say that something goes on to show the old one of an image that is replaced."""
        self.notices[still_shown(what, path)] = None

    def written(self, main: Sequence[Bytes] = (), notices: Iterable[str] = ()) -> Written:
        """Return the collected files with a main file, or without it."""
        return Written(main, self.sidecars, (*notices, *self.notices), self.copied)

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


def slots_by_path(images: NewImages, paths_of: Callable[[Slot, str], Iterable[str]]) -> SlotsByPath:
    """Return the slots in which a path, of an image or a set of tiles, gets the same new files; these go with it."""
    files: dict[tuple[str, Slot], list[tuple[str, ImageFile]]] = {}
    for (slot, file), image in images.items():
        for path in paths_of(slot, file):
            files.setdefault((path, slot), []).append((file, image))
    slots: SlotsByPath = {}
    for (path, slot), new in files.items():
        slots.setdefault((path, tuple(new)), []).append(slot)
    return slots


def new_files(path: str, new: str, sets: TileSets) -> dict[str, str]:
    """Return the new file of each file of a path, which is an image or one of some sets of tiles."""
    tiles = sets[path].items() if path in sets else ()
    return {file: file if path == new else tile_name(new, tile) for tile, file in tiles} or {path: new}


def common_suffix(suffixes: Iterable[str]) -> str | None:
    """Return the suffix that all tiles of a set have; None if they differ, so that their name cannot have it."""
    distinct = set(suffixes)
    return distinct.pop() if len(distinct) == 1 else None


def path_inside(path: str) -> str:
    """Return a path as it is, or for one outside the folder its name alone: nothing is written out there."""
    return PurePosixPath(path).name if is_outside(path) else path


def _renamed(path: str, source: str, stem: str) -> str:
    """Return a path named after another model: its old stem, as a word, is replaced, or the new one put in front."""
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
    """Return how a file refers to another after its move from `path` to `new`, with the folder as in `name`."""
    if new == path:
        return os.fsencode(name)
    plain = name.replace("\\", "/")
    # From some folder of the model, the name may be the path itself, or stand for it.
    if is_outside(path) or not f"/{path}".endswith(f"/{posixpath.normpath(plain)}"):
        return os.fsencode(new)
    return os.fsencode(name[: plain.rfind("/") + 1] + PurePosixPath(new).name)
