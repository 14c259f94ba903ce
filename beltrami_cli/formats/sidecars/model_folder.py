"""Files that a model refers to: which references are followed, and their paths."""

from __future__ import annotations

import contextlib
import os
import posixpath
import re
import stat
import unicodedata
from collections.abc import Mapping
from itertools import product
from pathlib import Path, PurePosixPath, PureWindowsPath

from beltrami_cli.errors import InputError, Obstacle
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access, read_regular
from beltrami_cli.formats.sidecars.tile_names import found_tiles, has_token, tile_name
from beltrami_cli.surface.tiling import COLUMNS, Tile

_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)  # of a URL, or a drive letter
_NETWORK = re.compile(r"[a-z][a-z0-9+.-]+:|//", re.IGNORECASE)
_MODEL_FOLDER = PurePosixPath()
_ENCODINGS = ("gbk", "cp932", "cp1252")  # of Windows in China, Japan and the West
_TILES = Obstacle(
    "stands for a set of tiles (UDIM), which are not read", "give each tile a material and a name of its own"
)
_OUTSIDE_FOLDER = Obstacle(
    "is a file in the folder of the model, which is not known", "give the model as a file, not through a pipe"
)
_OUTSIDE = Obstacle(
    "leaves the model's folder; only files inside it are read",
    "copy its files into the model's folder; for other formats than USD, --allow-outside reads them as well",
)

IGNORED = ", and is left alone."  # behind the cause why a file is not read


class UnfitReferenceError(Exception):
    """A reference that is not followed; the message is the cause, which follows the name in a sentence."""

    def __init__(self, cause: str, remedy: str = "") -> None:
        super().__init__(cause)
        self.obstacle = Obstacle(cause, remedy)


def _missing(hint: str) -> UnfitReferenceError:
    remedy = "keep the model's files together, under the names that it has for them"
    return UnfitReferenceError(f"is missing{hint}", remedy)


class ModelFolder:
    """The folder of a model (None: it has none); references outside of it are refused unless `access` allows them.

    `locate` finds a file by the name that the model has for it, `locate_any` tile sets as well, and `locate_similar`
    both, also where the name is not quite right. Each returns a path, by which `read` and `content` read the file, or
    raises UnfitReferenceError; `find` returns None instead.
    """

    def __init__(self, folder: Path | None, access: Access = DEFAULT_ACCESS) -> None:
        self._folder = None if folder is None else folder.resolve()
        self._located: dict[tuple[str, PurePosixPath], str | Obstacle] = {}
        self._listings: dict[Path, dict[str, str]] = {}
        self._tiles: dict[str, dict[Tile, str]] = {}  # cache of `tiles_of`
        self.access = access

    def find(self, name: str) -> str | None:
        try:
            return self.locate(name)
        except UnfitReferenceError:
            return None

    def locate(self, name: str, within: PurePosixPath = _MODEL_FOLDER) -> str:
        """Return the path of a regular file, relative to the folder; UnfitReferenceError if it cannot be used."""
        key = name, within
        if key not in self._located:  # A hostile file names the same one a million times.
            try:
                self._located[key] = self._locate(name, within)
            except UnfitReferenceError as error:
                self._located[key] = error.obstacle
        found = self._located[key]
        if isinstance(found, str):
            return found
        raise UnfitReferenceError(*found)

    def _locate(self, name: str, within: PurePosixPath) -> str:
        path = checked_path(name, within, outside=self.access.outside)
        if self._folder is None:
            raise UnfitReferenceError(*_OUTSIDE_FOLDER)
        if self.access.hooks.fetch is not None:
            self.access.hooks.fetch(self._folder / path)
        try:
            is_file = stat.S_ISREG(self.access.hooks.found_at(self._folder / path).stat().st_mode)
            there = (self._folder / path).resolve()
        except (FileNotFoundError, NotADirectoryError):
            similar = None if is_outside(path) else self._similar_path(path)
            raise _missing(
                f" (there is '{similar}', but capitals and accents count)" if similar else ""
            ) from None
        except (OSError, ValueError, RuntimeError):  # Names that no file can have: too long, or with a NUL.
            raise UnfitReferenceError("cannot be the name of a file") from None
        if not self.access.outside and not there.is_relative_to(self._folder):
            raise UnfitReferenceError("leads out of the model's folder; only files inside it are read")
        if not is_file:
            raise UnfitReferenceError("is not a regular file")
        if is_outside(path) and there.is_relative_to(self._folder):  # out, and in again
            return there.relative_to(self._folder).as_posix()
        return path

    def locate_similar(
        self, name: str, within: PurePosixPath = _MODEL_FOLDER, *, tiles: bool = True
    ) -> tuple[str, str]:
        """Return the path of a file (`tiles`: or tile set) by a name or a similar one, and the end of a notice or "".

        Exporters write absolute paths of their own machine, and names in its local encoding.
        """
        locate = self.locate_any if tiles else self.locate
        try:
            return locate(name, within), ""
        except UnfitReferenceError as error:
            failed = error
        for spelling in _spellings(name):
            last = PureWindowsPath(spelling).name
            for known, folder in ((spelling, within), (last, within), (last, _MODEL_FOLDER)):
                with contextlib.suppress(UnfitReferenceError):
                    path = locate(known, folder)
                    return path, f"is not followed; '{path}' in the model's folder is taken for it."
        raise failed

    def locate_any(self, pattern: str, within: PurePosixPath = _MODEL_FOLDER) -> str:
        """Return the path of a file or a tile set; UnfitReferenceError if it is missing."""
        if not has_token(pattern):
            return self.locate(pattern, within)
        path = checked_path(pattern, within, outside=self.access.outside, tiles=True)
        if not self.tiles_of(path):
            raise _missing(" (no tile of it is there)")
        return path

    def tiles_of(self, path: str | None) -> Mapping[Tile, str]:
        """Return the files of a tile set; none for the path of a file, and for None."""
        if path is None:
            return {}
        if path not in self._tiles:
            whole = PurePosixPath(path)
            self._tiles[path] = self._find_tiles(whole) if has_token(whole.name) else {}
        return self._tiles[path]

    def _find_tiles(self, path: PurePosixPath) -> dict[Tile, str]:
        if self._folder is None:
            raise UnfitReferenceError(*_OUTSIDE_FOLDER)
        folder = self._folder / path.parent
        if self.access.hooks.fetch is not None:
            # Storage that is not listed is asked for the hundred tiles that a set has at most in practice.
            for u, v in product(range(COLUMNS), range(10)):
                self.access.hooks.fetch(folder / tile_name(path.name, (u, v)))
        names = {*self._names_in(folder).values()}
        names |= {there.name for there in self.access.hooks.replacements if there.parent == folder}
        tiles = found_tiles(path.name, names)
        return {tile: self.locate(str(path.with_name(name))) for tile, name in tiles.items()}

    def files(self, path: str) -> list[str]:
        """Return the files of a tile set, or the path itself."""
        return [*self.tiles_of(path).values()] or [path]

    def files_by_label(self, paths: Mapping[str, str | None]) -> dict[str, str]:
        """Return the files of images and tile sets, by labels; None: not read."""
        found: dict[str, str] = {}
        for label, path in paths.items():
            tiles = self.tiles_of(path)
            found |= {f"{label}, tile {tile}": file for tile, file in tiles.items()}
            found |= {label: path} if path is not None and not tiles else {}
        return found

    def _similar_path(self, path: str) -> str | None:
        """Return the path of a file that differs only in case or in Unicode normalisation."""
        assert self._folder is not None
        found = PurePosixPath()
        for part in PurePosixPath(path).parts:
            name = self._names_in(self._folder / found).get(_case_folded(part))
            if name is None:
                return None
            found /= name
        return found.as_posix()

    def _names_in(self, folder: Path) -> dict[str, str]:
        """Return the names in a subfolder, by their case-folded form."""
        if folder not in self._listings:
            names: list[str] = []
            inside = self._folder is not None and folder.resolve().is_relative_to(self._folder)
            if inside or self.access.outside:
                with contextlib.suppress(OSError):
                    names = [entry.name for entry in folder.iterdir()]
            self._listings[folder] = {_case_folded(name): name for name in names}
        return self._listings[folder]

    def read(self, path: str, most: int = -1) -> bytes:
        """Return the content of a located file, at most `most` bytes; OSError if it cannot be read."""
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
    """Return the name as UTF-8, or else as decoded by the encodings of Windows programs."""
    octets, spellings = os.fsencode(name), []
    for encoding in ("utf-8", *_ENCODINGS):
        with contextlib.suppress(UnicodeDecodeError):
            spellings.append(octets.decode(encoding))
            if encoding == "utf-8":
                break
    return spellings


def _case_folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def checked_path(
    name: str, within: PurePosixPath = _MODEL_FOLDER, *, outside: bool, tiles: bool = False
) -> str:
    """Return the path of a name as `ModelFolder.locate` does, without accessing the disk."""
    plain = name.replace("\\", "/")
    if not name:
        raise UnfitReferenceError("is empty")
    if _NETWORK.match(plain) or (_SCHEME.match(plain) and not outside):
        raise UnfitReferenceError("is not a relative path; only files in the model's folder are read")
    if has_token(name) and not tiles:
        raise UnfitReferenceError(*_TILES)
    path = within / plain
    if any(part.startswith(".") and part != ".." for part in path.parts):
        raise UnfitReferenceError("is a hidden file, which is not read")
    if not outside and (path.is_absolute() or ".." in path.parts):
        raise UnfitReferenceError(*_OUTSIDE)
    return posixpath.normpath(path) if outside else str(path)


def is_outside(path: str) -> bool:
    """Whether a located path is outside of the model's folder."""
    return path.startswith(("/", "../")) or path == ".." or bool(_SCHEME.match(path))
