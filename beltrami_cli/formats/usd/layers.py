"""The files that a USD scene is made of, in a package or in a folder, and asking usd-core about them."""

from __future__ import annotations

import os
import posixpath
import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.foreign_library import ForeignLibrary, serve
from beltrami_cli.formats.model_folder import ModelFolder, UnfitReferenceError, is_outside
from beltrami_cli.formats.usd.package import LAYERS, Package
from beltrami_cli.surface.tiling import found_tiles, has_token

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array
    from beltrami_cli.formats.access import Access
    from beltrami_cli.surface.tiling import Tile

_EXPORT = "open and save it with a program for USD"
_USD_CORE = ForeignLibrary("beltrami_cli.formats.usd.layers", "usd", 5, _EXPORT)
_MOST_LAYERS = 2000
_CRATE = b"PXR-USDC"
_UNFIT = re.compile(r"[^\w .()+-]")

Answer = tuple[Any, "dict[str, Array]"]


@dataclass
class Layers:
    """The layers of a scene; those of a folder are found one by one, as others name them."""

    name: str
    access: Access
    package: Package | None
    folder: ModelFolder
    root: str
    contents: dict[str, bytes]  # by their paths from the folder of the root, the root first
    refused: list[tuple[str, str]] = field(default_factory=list)
    reasons: dict[str, str] = field(default_factory=dict)  # why, by what the path is
    tiles: dict[str, dict[Tile, str]] = field(default_factory=dict)  # files of sets, by the set's path

    @classmethod
    def of(cls, data: bytes, name: str, folder: Path | None, access: Access) -> Layers:
        """Take a package, or a root layer with a folder for the others."""
        beside = ModelFolder(folder, access)
        if data.startswith(b"PK"):
            package = Package(data, name, access)
            contents = {layer: package.read(layer) for layer in package.layers}
            return cls(name, access, package, beside, package.root, contents)
        suffix = ".usd" if name.lower().endswith(".usd") else ".usdc" if data.startswith(_CRATE) else ".usda"
        root = _UNFIT.sub("_", Path(name).stem).strip(". ") + suffix
        return cls(name, access, None, beside, root, {root: data})

    def scene(self, *, text: bool = False) -> Answer:
        """Read the scene, with all layers that it needs; `text`: with what `fingerprint` gives."""
        while True:
            words, arrays = self.ask({"task": "read", "text": text}, {})
            if "needs" not in words:
                return words, arrays
            for layer, path in words["needs"]:
                if (layer, path) in self.refused:  # it is asked for again, whatever that means
                    raise InputError(self.name, f"its layer {path[:80]!r} cannot be left out", _EXPORT)
                self._fetch(layer, path)

    def _fetch(self, layer: str, path: str) -> None:
        """Read a layer that another names, or note that it is refused."""
        try:
            file = self._located(layer, path)
            if self.package is None and file not in self.contents:
                self.contents[file] = self.folder.read(file)
        except UnfitReferenceError as error:
            self.reasons[path] = str(error)
            self.refused.append((layer, path))
        except OSError as error:
            self.reasons[path] = f"cannot be read ({error.strerror})"
            self.refused.append((layer, path))
        most = self.access.memory
        if len(self.contents) > _MOST_LAYERS or (
            most is not None and sum(map(len, self.contents.values())) > most
        ):
            raise InputError(self.name, "it has more layers than fit into memory", "raise --max-memory")

    def _located(self, layer: str, path: str) -> str:
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))
        if not wanted.lower().endswith(LAYERS):
            raise UnfitReferenceError("is no USD layer; only .usd, .usda and .usdc are read")
        if wanted in self.contents:
            raise UnfitReferenceError("names a layer in a way that is not understood")
        return self.locate(wanted)

    def locate(self, path: str) -> str:
        """Return the path of a file, or of a set of tiles, that the scene names; UnfitReferenceError if it is none."""
        if self.package is not None:
            return self._in_package(path)
        if has_token(path):
            found, self.tiles[path] = self.folder.locate_tiles(path)
        else:
            found = self.folder.locate(path)
        if is_outside(found):
            raise UnfitReferenceError("lies outside the model's folder, and USD files there are not read")
        return found

    def _in_package(self, path: str) -> str:
        assert self.package is not None
        beside = PurePosixPath(path)
        if has_token(path):
            names = [PurePosixPath(each) for each in self.package.members]
            near = [each.name for each in names if each.parent == beside.parent]
            tiles = found_tiles(beside.name, near)
            if tiles:
                self.tiles[path] = {tile: str(beside.with_name(file)) for tile, file in tiles.items()}
                return path
        elif path in self.package.members:
            return path
        raise UnfitReferenceError("is not in the package")

    def files(self, path: str) -> list[str]:
        """Return the file of a path, or those of a set of tiles."""
        return list(self.tiles[path].values()) if path in self.tiles else [path]

    def image(self, file: str) -> bytes:
        """Return the content of a file that was located; InputError if it cannot be read."""
        if self.package is not None:
            return self.package.read(file)
        try:
            return self.folder.read(file)
        except OSError as error:
            raise InputError(file, f"cannot be read ({error.strerror})") from error

    def ask(self, order: dict[str, Any], arrays: dict[str, Array]) -> Answer:
        """Let usd-core carry out an order on the layers."""
        with tempfile.TemporaryDirectory(prefix="beltrami-") as folder:
            for name, data in self.contents.items():
                path = Path(folder, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
            known = {"root": self.root, "layers": list(self.contents), "refused": self.refused}
            question = known | order | {"folder": folder}, arrays
            size = sum(map(len, self.contents.values()))
            return _USD_CORE.ask(question, self.name, size, self.access.memory)


def layer_from(text: bytes, suffix: str, name: str) -> bytes:
    """Return the text of a layer in the form that a suffix says."""
    with tempfile.TemporaryDirectory(prefix="beltrami-") as folder:
        order = {"task": "convert", "suffix": suffix, "folder": folder}
        question = order, {"text": np.frombuffer(text, np.uint8)}
        return _USD_CORE.ask(question, name, len(text), None)[1]["layer"].tobytes()


class UsdError(Exception):
    """What usd-core says of a layer."""


def _carry_out(order: dict[str, Any], arrays: dict[str, Array]) -> Answer:
    from pxr import Tf

    from beltrami_cli.formats.usd import editing

    os.chdir(order["folder"])
    try:
        return editing.TASKS[order["task"]](order, arrays)
    except Tf.ErrorException as error:
        raise UsdError(_said(str(error), order["folder"])) from error


def _said(error: str, folder: str) -> str:
    """Return the first message of an error, without names of C++ and the folder that the layers lie in for a while."""
    found = re.search(r" at line \d+ in file \S+ : '(.*?)'(?:\s*Error in '|\s*$)", error, re.DOTALL)
    message = error if found is None else found[1]
    return re.sub(r"pxrInternal_\w+::|" + re.escape(f"{folder}{os.sep}"), "", message)


if __name__ == "__main__":
    serve(_carry_out, "USD", "usd-core")
