"""Files beside a model that it names: which names are followed, and how new files there are called."""

from __future__ import annotations

import os
import re
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from beltrami_cli.formats.image.recognition import format_of_suffix

if TYPE_CHECKING:
    from pathlib import Path

_SCHEME = re.compile(r"^[a-z][a-z0-9+.-]*:", re.IGNORECASE)  # a URL, or the letter of a drive
_HERE = PurePosixPath()


class Beside:
    """The folder of a model, out of which no name leads.

    Parameters
    ----------
    folder : pathlib.Path or None
        Where the model lies; None if it lies in no folder, and so has no files beside it.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = None if folder is None else folder.resolve()

    def find(self, name: str, within: PurePosixPath = _HERE) -> str | None:
        r"""Return the path of a regular file inside the folder, relative to it and with "/", or None.

        Parameters
        ----------
        name : str
            As the model names it; "/" and "\" separate folders.
        within : PurePosixPath
            Where the file lies that names it, relative to the folder.
        """
        path = within / name.replace("\\", "/")
        if (
            self._folder is None
            or not name
            or path.is_absolute()
            or ".." in path.parts
            or _SCHEME.match(name)
        ):
            return None
        try:
            there = (self._folder / path).resolve()
            inside = there.is_relative_to(self._folder) and there.is_file()
        except (OSError, ValueError, RuntimeError):  # Names that no file can have: too long, or with a NUL.
            return None
        return str(path) if inside else None

    def read(self, path: str, most: int = -1) -> bytes:
        """Return the content of a file that `find` found, or its first bytes; OSError if it cannot be read."""
        if self._folder is None:
            raise FileNotFoundError(path)
        with (self._folder / path).open("rb") as file:
            return file.read(most)


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
    """Return a file's new name in the spelling of the old one, from which it differs in the last part only."""
    if new == path:
        return os.fsencode(name)
    folder = max(name.rfind("/"), name.rfind("\\")) + 1
    return os.fsencode(name[:folder] + PurePosixPath(new).name)
