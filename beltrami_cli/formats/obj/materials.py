"""Which files beside an OBJ file its materials need."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath

_LARGEST = 1 << 24  # bytes of a material file that are read
_MAPS = re.compile(
    rb"^[ \t]*(map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]+)", re.IGNORECASE | re.MULTILINE
)
_VECTOR = r"(?:[ \t]+[-+.\deE]+){1,3}"
_OPTION = re.compile(
    rf"-(?:(?:o|s|t){_VECTOR}|mm(?:[ \t]+\S+){{2}}|\w+[ \t]+\S+)[ \t]+", re.IGNORECASE
)  # fmt: skip
_SCHEME = re.compile(r"^[a-z][a-z0-9+.-]*:", re.IGNORECASE)  # a URL, or the letter of a drive


class Materials:
    """Existing files that an OBJ file names, directly or through its materials.

    Parameters
    ----------
    folder : pathlib.Path or None
        Where the OBJ file lies; None if it lies in no folder, and so has no files beside it.
    libraries : sequence of bytes
        What stands behind its `mtllib` keywords.

    Attributes
    ----------
    paths : list of str
        Relative to the folder, "/" separates; all are regular files inside it.
    notices : list of str
        One sentence for each file that is missing or lies elsewhere, and so is left alone.
    """

    def __init__(self, folder: Path | None, libraries: list[bytes]) -> None:
        self.paths: list[str] = []
        self.notices: list[str] = []
        if folder is None:
            return
        self._folder = folder.resolve()
        for line in libraries:
            for library in self._library_names(os.fsdecode(line)):
                if self._add(library, PurePosixPath()):
                    self._add_textures(library)

    def _library_names(self, line: str) -> list[str]:
        """Split the names of several libraries, which may hold blanks."""
        if self._file(line, PurePosixPath()) is not None:
            return [line]
        return re.findall(r"\S.*?\.mtl(?=\s|$)", line, re.IGNORECASE) or line.split()

    def _add_textures(self, library: str) -> None:
        beside = PurePosixPath(library.replace("\\", "/")).parent
        with (self._folder / library.replace("\\", "/")).open("rb") as file:
            text = file.read(_LARGEST)
        for match in _MAPS.finditer(text):
            texture = os.fsdecode(match[2]).strip()
            while option := _OPTION.match(texture):
                texture = texture[option.end() :]
            self._add(texture, beside)

    def _add(self, name: str, beside: PurePosixPath) -> bool:
        """Add a file once; tell whether it is there."""
        path = self._file(name, beside)
        if path is None:
            sentence = f"'{name}' is missing or not inside the model's folder, and is left alone."
            self.notices += [] if sentence in self.notices else [sentence]
            return False
        self.paths += [] if path in self.paths else [path]
        return True

    def _file(self, name: str, beside: PurePosixPath) -> str | None:
        """Return the relative path of a regular file inside the folder, or None."""
        path = beside / name.replace("\\", "/")
        if not name or path.is_absolute() or ".." in path.parts or _SCHEME.match(name):
            return None
        try:
            there = (self._folder / path).resolve()
            inside = there.is_relative_to(self._folder) and there.is_file()
        except (OSError, ValueError):  # Names that no file can have: too long, or with a NUL.
            return None
        return str(path) if inside else None
