"""The materials of an OBJ file, from all its libraries, and the files that they need."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.formats.model_folder import (
    LEFT_ALONE,
    LEFT_OUTSIDE,
    ModelFolder,
    UnfitReferenceError,
    is_outside,
)
from beltrami_cli.formats.obj.libraries import SLOTS, Map, read_maps

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from beltrami_cli.surface.records import Slot

_LARGEST = 1 << 24  # bytes of a material file that are read
_MOST_NOTICES = 20
_END_OF_NAME = re.compile(r"\.mtl(?=\s|$)", re.IGNORECASE)
_WORD = re.compile(r"\S+")


@dataclass(frozen=True)
class Library:
    """A material file.

    Attributes
    ----------
    path : str
        Relative to the folder of the model.
    data : bytes
        Its content.
    materials : frozenset of str
        Names of its materials.
    maps : tuple of (Map, str or None)
        Its maps in file order, each with the path of its file if that can be used.
    mentions : tuple of (str, int, int)
        Its name in the OBJ file wherever that is, and from where to where it stands there.
    """

    path: str
    data: bytes
    materials: frozenset[str]
    maps: tuple[tuple[Map, str | None], ...]
    mentions: tuple[tuple[str, int, int], ...]


class Materials:
    """Existing files that an OBJ file names, directly or through its materials.

    Parameters
    ----------
    beside : ModelFolder
        The folder in which the OBJ file lies.
    statements : sequence of (bytes, int)
        What stands behind its `mtllib` keywords, and where in the file.

    Attributes
    ----------
    paths : list of str
        Regular files inside the folder, relative to it, "/" separates.
    libraries : list of Library
        In the order in which they are named first.
    notices : list of str
        One sentence for each file that is missing or lies elsewhere, and so is left alone.
    """

    def __init__(self, beside: ModelFolder, statements: Sequence[tuple[bytes, int]]) -> None:
        self.paths: list[str] = []
        self.notices: list[str] = []
        self._beside = beside
        self._reasons: dict[str, str] = {}
        self._listed: set[str] = set()
        mentions: dict[str, list[tuple[str, int, int]]] = {}
        for text, start in statements:
            for name, begin in self._names(text, start):
                path = self._found(name, PurePosixPath())
                if path is not None:
                    mentions.setdefault(path, []).append((name, begin, begin + len(os.fsencode(name))))
        self.libraries = [self._read(path, places) for path, places in mentions.items()]
        self._shown: dict[tuple[str, Slot], tuple[Map, str | None]] = {}
        known: set[str] = set()
        for library in self.libraries:
            self._take(library, known)
            known |= library.materials

    def painting(self, material: str, slot: Slot) -> tuple[Map, str | None] | None:
        """Return the map that a material has in a slot, and its file if that can be used."""
        return self._shown.get((material, slot))

    def reason(self, name: str) -> str:
        """Return why a file is not read that a map names."""
        return self._reasons.get(name, "cannot be read").rstrip(".")

    def read(self, path: str) -> bytes:
        """Return the content of a file that was found; InputError if it has become unreadable."""
        try:
            return self._beside.read(path)
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})") from error

    def slots(self) -> set[Slot]:
        """Return the slots that some material has a map in."""
        return {slot for _, slot in self._shown}

    def uses(self, path: str) -> int:
        """Return how many maps there are to a file."""
        return sum(used == path for library in self.libraries for _, used in library.maps)

    def affected(self, slot: Slot, path: str) -> Iterator[tuple[Library, Map]]:
        """Give all maps by which an image is seen in a slot.

        With the base colour go maps of the same material to the same file for ambient light and opacity: they
        show the same paint, and its alpha does not change.
        """
        for library in self.libraries:
            painted = {m.material for m, p in library.maps if p == path and SLOTS.get(m.keyword) == slot}
            for found, its_path in library.maps:
                along = (
                    slot == "baseColor" and found.keyword in ("map_ka", "map_d") and found.material in painted
                )
                if its_path == path and (along or SLOTS.get(found.keyword) == slot):
                    yield library, found

    def _take(self, library: Library, known: set[str]) -> None:
        """Note the maps of materials that no library before has: the last of the keyword that counts most."""
        for keyword, slot in reversed(SLOTS.items()):
            for found, path in library.maps:
                if found.keyword == keyword and found.material not in known:
                    self._shown[found.material, slot] = found, path

    def _names(self, text: bytes, start: int) -> Iterator[tuple[str, int]]:
        """Split the names of several libraries, which may hold blanks; give each with its place."""
        whole = os.fsdecode(text)
        if len(whole) > 2 and whole[0] == whole[-1] == '"':
            whole, start = whole[1:-1], start + 1
        if self._beside.find(whole) is not None:
            yield whole, start
            return
        done = 0
        for begin, end in _split(whole.split(" #")[0]):  # A comment may follow.
            start += len(os.fsencode(whole[done:begin]))
            done = begin
            yield whole[begin:end], start

    def _read(self, path: str, mentions: list[tuple[str, int, int]]) -> Library:
        try:
            data = self._beside.read(path, _LARGEST + 1)
        except OSError as error:
            self.notices.append(f"'{path}' cannot be read ({error.strerror}){LEFT_ALONE}")
            data = b""
        if len(data) > _LARGEST:
            self.notices.append(f"'{path}' has more than {_LARGEST} bytes{LEFT_ALONE}")
            data = b""
        materials, maps = read_maps(data)
        within = PurePosixPath(path).parent
        found = tuple((known, self._found(known.name, within)) for known in maps)
        return Library(path, data, frozenset(materials), found, tuple(mentions))

    def _found(self, name: str, within: PurePosixPath) -> str | None:
        """Return the path of a file, adding it once, or None with a notice if it is not there."""
        try:
            path = self._beside.locate(name, within)
        except UnfitReferenceError as error:
            self._tell(name, str(error), LEFT_ALONE)
            return None
        if is_outside(path):
            self._tell(name, LEFT_OUTSIDE)
        elif path not in self._listed:
            self._listed.add(path)
            self.paths.append(path)
        return path

    def _tell(self, name: str, reason: str, behind: str = "") -> None:
        """Give notice of a file, once; of a million files, of the first few."""
        if name in self._reasons:
            return
        self._reasons[name] = reason
        if len(self._reasons) <= _MOST_NOTICES:
            self.notices.append(f"'{name}' {reason}{behind}")
        elif len(self._reasons) == _MOST_NOTICES + 1:
            self.notices.append("Further files are missing as well.")


def _split(names: str) -> Iterator[tuple[int, int]]:
    """Give where each of several names of libraries stands: up to .mtl or, behind the last of these, each word."""
    at = 0
    for match in _END_OF_NAME.finditer(names):
        begin = at + len(names[at : match.end()]) - len(names[at : match.end()].lstrip())
        yield begin, match.end()
        at = match.end()
    for match in _WORD.finditer(names, at):
        yield match.span()
