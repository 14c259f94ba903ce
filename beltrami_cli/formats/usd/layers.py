"""The files of a USD scene, in a package or in a folder, and requests to usd-core about them.

A USDZ package is a ZIP archive of stored files that start at multiples of 64 bytes.

References
----------
.. [1] "Usdz file format specification", version 1.3. https://openusd.org/release/spec_usdz.html
"""

from __future__ import annotations

import io
import os
import posixpath
import re
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, MemoryLimitError, Obstacle
from beltrami_cli.formats.access import Access, require_ratio
from beltrami_cli.formats.archives import Archive
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.foreign_library import ForeignLibrary, serve_files
from beltrami_cli.formats.model_folder import ModelFolder, UnfitReferenceError, is_outside
from beltrami_cli.formats.tile_names import found_tiles, has_token
from beltrami_cli.formats.usd.contents import SceneContents
from beltrami_cli.surface.temporary_files import temporary_folder, writing_temporary_files
from beltrami_cli.surface.worker_process import Message

LAYERS = (".usd", ".usda", ".usdc")  # suffixes of files that usd-core reads
IMAGES = (".png", ".jpg", ".jpeg", ".exr", ".avif")  # suffixes of images that a package may hold [1]_
_SOUNDS = (".m4a", ".mp3", ".wav")
_ALIGNMENT, _PADDING = 64, 0x1986  # alignment in bytes, and the ID of extra fields for padding
_LOCAL_HEADER = struct.Struct("<4s5H3L2H")  # of a ZIP entry, before the name
_FIELD = struct.Struct("<2H")  # ID and length of an extra field
Date = tuple[int, int, int, int, int, int]
_DATE: Date = (1980, 1, 1, 0, 0, 0)  # fixed, so that packages are reproducible
_UNIX = 3


class Package(Archive):
    """An opened package, whose first file is the root layer."""

    def __init__(self, data: bytes, name: str, access: Access) -> None:
        super().__init__(data, name, access)
        self._data = data
        require_ratio(name, "the package", len(data), sum(entry.file_size for entry in self.entries))
        wrong = next((member for member in self.members if _is_unfit(member)), None)
        if wrong is not None or len(self.members) != len(self.entries):
            cause = "it has two files of one name" if wrong is None else f"it has a file named {wrong[:80]!r}"
            raise InputError(name, f"{cause}, which a package cannot have", "export it again")
        if not self.members or not self.members[0].lower().endswith(LAYERS):
            raise InputError(
                name, "its first file is not a USD layer", "export it again, by a program for USDZ"
            )
        self.layers = [member for member in self.members if member.lower().endswith(LAYERS)]

    def faults(self) -> list[str]:
        """Return violations of USDZ packing, one sentence each; readers that map packages into memory fail on them."""
        found = []
        for entry in self.entries:
            *_, name_size, extra_size = _LOCAL_HEADER.unpack_from(self._data, entry.header_offset)
            start = entry.header_offset + _LOCAL_HEADER.size + name_size + extra_size
            if entry.compress_type:
                found.append(f"{entry.filename} is compressed")
            elif start % _ALIGNMENT:
                found.append(f"{entry.filename} does not start at a multiple of {_ALIGNMENT} bytes")
            if not entry.filename.lower().endswith((*LAYERS, *IMAGES, *_SOUNDS)):
                found.append(f"{entry.filename} is of a type that no package may hold")
        return found

    def packed(self, new: Mapping[str, Bytes]) -> list[Bytes]:
        """Return the package with new files: replacements keep their place, others are appended."""
        contents = {member: new.get(member) or self.read(member) for member in self.members}
        return packed(contents | dict(new), {entry.filename: entry.date_time for entry in self.entries})


def _is_unfit(name: str) -> bool:
    plain = posixpath.normpath(name)
    return plain != name or name.startswith(("/", "../")) or name == ".." or "\\" in name or ":" in name


def packed(files: Mapping[str, Bytes], dates: Mapping[str, Date] | None = None) -> list[Bytes]:
    """Return a package of files in the given order."""
    stream = io.BytesIO()
    try:
        with zipfile.ZipFile(stream, "w", allowZip64=False) as package:
            for name, content in files.items():
                entry = zipfile.ZipInfo(name, (dates or {}).get(name, _DATE))
                entry.create_system = _UNIX  # on every system, so that packages are reproducible
                padding = -(stream.tell() + _LOCAL_HEADER.size + len(name.encode())) % _ALIGNMENT
                padding += _ALIGNMENT if 0 < padding < _FIELD.size else 0
                filling = padding - _FIELD.size
                entry.extra = _FIELD.pack(_PADDING, filling) + bytes(filling) if padding else b""
                package.writestr(entry, content)
    except zipfile.LargeZipFile:
        raise InputError(name, "the package would have more than 2 GB", "choose smaller textures") from None
    return [stream.getbuffer()]


_EXPORT = "open and save it with a program for USD"
_USD_CORE = ForeignLibrary("beltrami_cli.formats.usd.layers", "usd", 5, _EXPORT)
_MAX_LAYERS = 2000
_CRATE = b"PXR-USDC"
_NO_MEMORY = "std::bad_alloc"  # in messages of usd-core
_UNFIT = re.compile(r"[^\w .()+-]")


@dataclass
class Layers:
    """The layers of a scene; those in a folder are loaded one by one, as other layers refer to them."""

    name: str
    access: Access
    package: Package | None
    folder: ModelFolder
    root: str
    contents: dict[str, bytes]  # by path relative to the folder of the root layer, which comes first
    refused: list[tuple[str, str]] = field(default_factory=list)
    obstacles: dict[str, Obstacle] = field(default_factory=dict)  # why files are not read, by path

    @classmethod
    def of(cls, data: bytes, name: str, folder: Path | None, access: Access) -> Layers:
        """Open a package, or a root layer with the folder of the others."""
        around = ModelFolder(folder, access)
        if data.startswith(b"PK"):
            package = Package(data, name, access)
            contents = {layer: package.read(layer) for layer in package.layers}
            return cls(name, access, package, around, package.layers[0], contents)
        suffix = ".usd" if name.lower().endswith(".usd") else ".usdc" if data.startswith(_CRATE) else ".usda"
        root = _UNFIT.sub("_", Path(name).stem).strip(". ") + suffix
        return cls(name, access, None, around, root, {root: data})

    @property
    def others(self) -> list[str]:
        """The paths of all layers but the root."""
        return [layer for layer in self.contents if layer != self.root]

    def scene(self, *, text: bool = False) -> tuple[SceneContents, dict[str, Array]]:
        """Read the scene, with all layers that it needs; `text`: with the text of the root layer for fingerprints."""
        while True:
            found, arrays = self.ask({"task": "read", "text": text}, {})
            if "needs" not in found:
                return SceneContents.from_json(found), arrays
            for layer, path in found["needs"]:
                if (layer, path) in self.refused:  # usd-core asks for it again, so it is needed
                    raise InputError(self.name, f"its layer {path[:80]!r} cannot be left out", _EXPORT)
                self._fetch(layer, path)

    def _fetch(self, layer: str, path: str) -> None:
        """Read a layer that another one refers to, or record that it is refused."""
        try:
            wanted = posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))
            if not wanted.lower().endswith(LAYERS):
                remedy = "write the scene as one layer (usdcat --flatten), and give that"
                raise UnfitReferenceError("is not a USD layer; only .usd, .usda and .usdc are read", remedy)
            if wanted in self.contents:
                raise UnfitReferenceError("names a layer in a way that is not understood")
            file = self.locate(wanted)
            if self.package is None and file not in self.contents:
                self.contents[file] = self.folder.read(file)
        except UnfitReferenceError as error:
            self._refuse(layer, path, error.obstacle)
        except OSError as error:
            self._refuse(layer, path, Obstacle(f"cannot be read ({error.strerror})"))
        most, size = self.access.memory, sum(map(len, self.contents.values()))
        if len(self.contents) > _MAX_LAYERS or (most is not None and size > most):
            raise MemoryLimitError(self.name, "it has more layers than fit into memory", "raise --max-memory")

    def _refuse(self, layer: str, path: str, why: Obstacle) -> None:
        self.refused.append((layer, path))
        self.obstacles[path] = why

    def locate(self, path: str) -> str:
        """Return the path of a file or tile set that the scene refers to; UnfitReferenceError if it cannot be used."""
        if self.package is None:
            found = self.folder.locate_any(path)
            if is_outside(found):
                cause = "lies outside the model's folder, and USD files there are not read"
                remedy = "copy all files of the scene into one folder, or write it as one package (usdzip)"
                raise UnfitReferenceError(cause, remedy)
            return found
        if has_token(path):
            pattern, names = PurePosixPath(path), map(PurePosixPath, self.package.members)
            tiles = found_tiles(pattern.name, [each.name for each in names if each.parent == pattern.parent])
            self.folder.tiles[path] = {tile: str(pattern.with_name(file)) for tile, file in tiles.items()}
        if path not in self.package.members and not self.folder.tiles.get(path):
            raise UnfitReferenceError("is not in the package")
        return path

    def image(self, file: str) -> bytes:
        """Return the content of a file at a path of `locate`; InputError if it cannot be read."""
        return self.folder.content(file) if self.package is None else self.package.read(file)

    def ask(self, order: dict[str, Any], arrays: dict[str, Array]) -> Message:
        """Send a request about the layers to usd-core, and return its answer."""
        with writing_temporary_files(), temporary_folder() as folder:
            for name, data in self.contents.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
            known = {"root": self.root, "layers": list(self.contents), "refused": self.refused}
            question = known | order | {"folder": str(folder)}, arrays
            size = sum(map(len, self.contents.values()))
            return _USD_CORE.ask(question, self.name, size, self.access.memory)


def layer_from(text: bytes, suffix: str, name: str) -> bytes:
    """Convert a layer from text to the encoding of a suffix."""
    with temporary_folder() as folder:
        order = {"task": "convert", "suffix": suffix, "folder": str(folder)}
        question = order, {"text": np.frombuffer(text, np.uint8)}
        return _USD_CORE.ask(question, name, len(text), None)[1]["layer"].tobytes()


class UsdError(Exception):
    """An error that usd-core reports for a layer."""


def _carry_out(order: dict[str, Any], arrays: dict[str, Array]) -> Message:
    from pxr import Tf

    from beltrami_cli.formats.usd import editing, reading

    os.chdir(order["folder"])
    task = {"read": reading.read, "edit": editing.edit, "convert": editing.convert}[order["task"]]
    try:
        return task(order, arrays)
    except Tf.ErrorException as error:
        if _NO_MEMORY in str(error):
            raise MemoryError from error
        raise UsdError(_first_message(str(error), order["folder"])) from error


def _first_message(error: str, folder: str) -> str:
    """Return the first message of an error, without C++ namespaces and the path of the temporary folder."""
    found = re.search(r" at line \d+ in file \S+ : '(.*?)'(?:\s*Error in '|\s*$)", error, re.DOTALL)
    message = error if found is None else found[1]
    return re.sub(r"pxrInternal_\w+::|" + re.escape(f"{folder}{os.sep}"), "", message)


if __name__ == "__main__":
    serve_files(_carry_out, "USD", "usd-core")
