"""Names of the files beside an output: after the output, or those of the source where it replaces that."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from beltrami_cli.formats.image.recognition import format_of_suffix
from beltrami_cli.formats.model_folder import is_outside

if TYPE_CHECKING:
    from collections.abc import Iterable

    from beltrami_cli.formats.document import Naming

_HERE = PurePosixPath()
_LONGEST = 255  # bytes of a name, on all usual file systems


class NewNames:
    """Gives the files beside one output their names, each once."""

    def __init__(self, naming: Naming, source: str, present: Iterable[str], missing: Iterable[str]) -> None:
        """`source` is the model's own name; `present` and `missing` are the files that it refers to."""
        self.copies = naming.copies
        self._naming, self._source = naming, Path(source).stem
        # In another folder what is present gets other names, and references to what is missing stay.
        self._taken = {path.casefold() for path in (*missing, *(() if naming.copies else present))}

    def image(self, path: str, suffix: str | None = None, *, is_replaced: bool = True) -> str:
        """Return the path of an image in place of another; `is_replaced`: nothing shows that one any more."""
        keeps = self._naming.keeps and is_replaced
        new = path_inside(path)
        if not keeps:
            new = _renamed(new, self._source, self._naming.stem)
        if suffix is not None:
            new = _with_suffix(new, suffix)
        return self._reserve(new, may_stay=keeps and new == path)

    def other(self, path: str, suffix: str) -> str:
        """Return the path of a file that is no image, in place of another."""
        if self._naming.keeps and not is_outside(path):
            return self._reserve(path, may_stay=True)
        return self.new(suffix, PurePosixPath(path_inside(path)).parent)

    def new(self, suffix: str, folder: PurePosixPath = _HERE) -> str:
        """Return the path of a file that replaces none: the stem with a suffix."""
        return self._reserve(str(folder / (self._naming.stem + suffix)))

    def _reserve(self, path: str, *, may_stay: bool = False) -> str:
        whole, number = PurePosixPath(path), 2
        while not may_stay and (path.casefold() in self._taken or self._naming.is_taken(path)):
            path = str(whole.with_name(f"{whole.stem}-{number}{whole.suffix}"))
            number += 1
        self._taken.add(path.casefold())
        return path


def path_inside(path: str) -> str:
    """Return a path as it is, or for one outside the folder its name alone: nothing is written out there."""
    return PurePosixPath(path).name if is_outside(path) else path


def _renamed(path: str, source: str, stem: str) -> str:
    """Return a path named after another model: its old stem, as a word, is replaced, or the new one put in front."""
    whole = PurePosixPath(path)
    word = rf"(?<![^\W_]){re.escape(source)}(?![^\W_])"
    new, count = re.subn(word, lambda _: stem, whole.name, count=1)
    new = new if count else f"{stem}_{whole.name}"
    if len(os.fsencode(new)) > _LONGEST:
        new = stem + whole.suffix
    return str(whole.with_name(new))


def _with_suffix(path: str, suffix: str) -> str:
    """Return a path with the suffix of an image format; unchanged if it already has one of that format."""
    old = PurePosixPath(path).suffix
    if format_of_suffix(old) == format_of_suffix(suffix):
        return path
    return str(PurePosixPath(path).with_suffix(suffix))


def new_reference(name: str, path: str, new: str) -> bytes:
    """Return how a file refers to another after its move from `path` to `new`, with the folder as in `name`."""
    if new == path:
        return os.fsencode(name)
    plain = name.replace("\\", "/")
    if is_outside(path) or ".." in PurePosixPath(plain).parts:
        return os.fsencode(new)
    return os.fsencode(name[: plain.rfind("/") + 1] + PurePosixPath(new).name)
