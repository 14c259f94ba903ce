"""Files beside a model that it names: which names are followed, and how new files there are called."""

from __future__ import annotations

import contextlib
import os
import posixpath
import re
import stat
import unicodedata
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_regular
from beltrami_cli.formats.image.recognition import format_of_suffix

if TYPE_CHECKING:
    from pathlib import Path

_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)  # a URL, or the letter of a drive
_NETWORK = re.compile(r"[a-z][a-z0-9+.-]+:|//", re.IGNORECASE)
_HERE = PurePosixPath()
_MISSING, _TILES = "is missing", "stands for a set of tiles (UDIM), which are not read"
_NOWHERE = "is a file beside the model, whose folder is not known"
_REMEDIES = {
    _MISSING: "keep the model's files together, under the names that it has for them",
    _TILES: "give each tile a material and a name of its own",
    _NOWHERE: "give the model as a file, not through a pipe",
}

LEFT_ALONE = ", and is left alone."  # behind the reason why a file is not read
LEFT_OUTSIDE = "lies outside the model's folder; the output names it as the input does, and it is not copied."


class UnfitReferenceError(Exception):
    """A name that is not followed; the message is the reason, to be put behind the name."""


class Beside:
    """The folder of a model, out of which no name leads unless that is allowed.

    Parameters
    ----------
    folder : pathlib.Path or None
        Where the model lies; None if it lies in no folder, and so has no files beside it.
    access : Access
        What may be read.
    """

    def __init__(self, folder: Path | None, access: Access = EVERYTHING_INSIDE) -> None:
        self._folder = None if folder is None else folder.resolve()
        self._known: dict[tuple[str, PurePosixPath], str | UnfitReferenceError] = {}
        self._spellings: dict[Path, dict[str, str]] = {}
        self.access = access

    def find(self, name: str, within: PurePosixPath = _HERE) -> str | None:
        """Return what `locate` does, or None where that raises."""
        try:
            return self.locate(name, within)
        except UnfitReferenceError:
            return None

    def locate(self, name: str, within: PurePosixPath = _HERE) -> str:
        r"""Return the path of a regular file, relative to the folder and with "/".

        Parameters
        ----------
        name : str
            As the model names it; "/" and "\" separate folders.
        within : PurePosixPath
            Where the file lies that names it, relative to the folder.

        Returns
        -------
        str
            Inside the folder; if more is allowed, it may start with ".." or "/", see `is_outside`.

        Raises
        ------
        UnfitReferenceError
            If there is no such file, or the name must not be followed.
        """
        key = name, within
        if key not in self._known:  # A hostile file names the same one a million times.
            try:
                self._known[key] = self._locate(name, within)
            except UnfitReferenceError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, UnfitReferenceError):
            raise UnfitReferenceError(str(found))
        return found

    def _locate(self, name: str, within: PurePosixPath) -> str:
        path = meant_path(name, within, outside=self.access.outside)
        if self._folder is None:
            raise UnfitReferenceError(_NOWHERE)
        if self.access.bring is not None:
            self.access.bring(self._folder / path)
        try:
            is_file = stat.S_ISREG((self._folder / path).stat().st_mode)
            there = (self._folder / path).resolve()
        except (FileNotFoundError, NotADirectoryError):
            alike = None if is_outside(path) else self._spelled_alike(path)
            hint = f" (there is '{alike}', but capitals and accents count)" if alike else ""
            raise UnfitReferenceError(f"{_MISSING}{hint}") from None
        except (OSError, ValueError, RuntimeError):  # Names that no file can have: too long, or with a NUL.
            raise UnfitReferenceError("cannot be the name of a file") from None
        if not self.access.outside and not there.is_relative_to(self._folder):
            raise UnfitReferenceError("leads out of the model's folder; only files inside it are read")
        if not is_file:
            raise UnfitReferenceError("is not a regular file")
        if is_outside(path) and there.is_relative_to(self._folder):  # out, and in again
            return there.relative_to(self._folder).as_posix()
        return path

    def _spelled_alike(self, path: str) -> str | None:
        """Return a file that has a path in other capitals, or with accents coded in another way."""
        assert self._folder is not None
        found = PurePosixPath()
        for part in PurePosixPath(path).parts:
            name = self._names_in(self._folder / found).get(_plain(part))
            if name is None:
                return None
            found /= name
        return found.as_posix()

    def _names_in(self, folder: Path) -> dict[str, str]:
        """Return the names in a folder of the model's, by what they are without capitals."""
        if folder not in self._spellings:
            names: list[str] = []
            if self._folder is not None and folder.resolve().is_relative_to(self._folder):
                with contextlib.suppress(OSError):
                    names = [entry.name for entry in folder.iterdir()]
            self._spellings[folder] = {_plain(name): name for name in names}
        return self._spellings[folder]

    def read(self, path: str, most: int = -1) -> bytes:
        """Return the content of a file that was located, or its first bytes; OSError if it cannot be read."""
        if self._folder is None:
            raise FileNotFoundError(path)
        return read_regular(self._folder / path, self.access, most)


def _plain(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def meant_path(name: str, within: PurePosixPath = _HERE, *, outside: bool) -> str:
    r"""Return the path that a name means, without looking at the disk.

    Parameters
    ----------
    name, within
        As for `Beside.locate`.
    outside : bool
        Whether it may lead out of the model's folder.

    Raises
    ------
    UnfitReferenceError
        If it must not be followed.
    """
    plain = name.replace("\\", "/")
    if not name:
        raise UnfitReferenceError("is empty")
    if _NETWORK.match(plain) or (_SCHEME.match(plain) and not outside):
        raise UnfitReferenceError("is not a relative path; only files beside the model are read")
    if "<UDIM>" in name or "<UVTILE>" in name:
        raise UnfitReferenceError(_TILES)
    path = within / plain
    if any(part.startswith(".") and part != ".." for part in path.parts):
        raise UnfitReferenceError("is a hidden file, which is not read")
    if not outside and (path.is_absolute() or ".." in path.parts):
        raise UnfitReferenceError("leaves the model's folder; only files inside it are read")
    return posixpath.normpath(path) if outside else str(path)


def remedy_for(reason: str) -> str:
    """Return what can be done where a file is not read for a reason, "" if that is no matter of its name."""
    return next((remedy for known, remedy in _REMEDIES.items() if known in reason), "")


def is_outside(path: str) -> bool:
    """Tell whether a located path leads out of the model's folder."""
    return path.startswith(("/", "../")) or path == ".." or bool(_SCHEME.match(path))


def brought_inside(path: str) -> str:
    """Return a path as it is, or for one outside the folder its name alone: nothing is written out there."""
    return PurePosixPath(path).name if is_outside(path) else path


def renamed(path: str, source: str, stem: str) -> str:
    """Return a path named after another model: the old one's stem in it replaced as a word, or the new put in front.

    Parameters
    ----------
    path : str
        Path of a file beside the model.
    source, stem : str
        Stem of the model's name, old and new.
    """
    name = PurePosixPath(path).name
    word = rf"(?<![^\W_]){re.escape(source)}(?![^\W_])"
    new, count = re.subn(word, lambda _: stem, name, count=1)
    return str(PurePosixPath(path).with_name(new if count else f"{stem}_{name}"))


def with_suffix(path: str, suffix: str) -> str:
    """Return a path that ends as an image format asks for; unchanged if it already does."""
    old = PurePosixPath(path).suffix
    if format_of_suffix(old) == format_of_suffix(suffix):
        return path
    return str(PurePosixPath(path).with_suffix(suffix))


def unused(path: str, taken: set[str]) -> str:
    """Return a path that is not among the taken ones (which are case folded), numbered from 2 on if need be."""
    whole, number = PurePosixPath(path), 2
    while path.casefold() in taken:
        path = str(whole.with_name(f"{whole.stem}-{number}{whole.suffix}"))
        number += 1
    return path


def respelled(name: str, path: str, new: str) -> bytes:
    """Return a file's new name in the spelling of the old one, from which it differs in the last part only.

    Parameters
    ----------
    name : str
        As a file in the model's folder names it.
    path, new : str
        Where that led, and where it is to lead, relative to the model's folder.
    """
    if new == path:
        return os.fsencode(name)
    folder = 0 if is_outside(path) else max(name.rfind("/"), name.rfind("\\")) + 1
    return os.fsencode(name[:folder] + PurePosixPath(new).name)
