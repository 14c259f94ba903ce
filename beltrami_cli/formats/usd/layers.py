"""The layers of a USD scene, in a package or in a folder, and requests to usd-core about them."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.errors import InputError, MemoryLimitError, Obstacle
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.foreign_library import ForeignLibrary
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError
from beltrami_cli.formats.usd.contents import (
    ColourBlock,
    EditRequest,
    SceneContents,
    SceneRequest,
    TextRequest,
)
from beltrami_cli.formats.usd.folders import PackageFolder, UsdFolder
from beltrami_cli.formats.usd.package import LAYERS, Package
from beltrami_cli.surface.temporary_files import temporary_folder, writing_temporary_files
from beltrami_cli.surface.worker_process import Message

_EXPORT = "open and save it with a program for USD"
_USD_CORE = ForeignLibrary("beltrami_cli.formats.usd.process", "usd", 5, _EXPORT)
_MAX_LAYERS = 2000  # bounds the time: each that names another one takes a further process, of 0.3 s
_CRATE = b"PXR-USDC"
_UNFIT = re.compile(r"[^\w .()+-]")


@dataclass
class Layers:
    """The layers of a scene; those in a folder are loaded one by one, as other layers refer to them."""

    name: str
    access: Access
    package: Package | None
    folder: ModelFolder
    root: str
    data: dict[str, bytes]  # by path relative to the folder of the root layer, which comes first
    # Why paths of layers are left out, by the layer that has the path.
    refused: dict[tuple[str, str], Obstacle] = field(default_factory=dict)

    @classmethod
    def of(cls, data: bytes, name: str, folder: Path | None, access: Access) -> Layers:
        """Open a package, or a root layer with the folder of the others."""
        if data.startswith(b"PK"):
            package = Package(data, name, access)
            layers = {layer: package.read(layer) for layer in package.layers}
            return cls(name, access, package, PackageFolder(package), package.layers[0], layers)
        suffix = ".usd" if name.lower().endswith(".usd") else ".usdc" if data.startswith(_CRATE) else ".usda"
        root = _UNFIT.sub("_", Path(name).stem).strip(". ") + suffix
        return cls(name, access, None, UsdFolder(folder, access), root, {root: data})

    @property
    def others(self) -> list[str]:
        """The paths of all layers but the root."""
        return [layer for layer in self.data if layer != self.root]

    def scene(self) -> SceneContents:
        """Read the scene, with all layers that it needs."""
        while True:
            answer, arrays = self._ask("read", self._request, {})
            if "needs" not in answer:
                unread = {path: why for (_, path), why in self.refused.items()}
                return SceneContents.from_message(answer, arrays, unread)
            for layer, path in answer["needs"]:
                if (layer, path) in self.refused:  # usd-core asks for it again, so it is needed
                    raise InputError(self.name, f"its layer {path[:80]!r} cannot be left out", _EXPORT)
                self._fetch(layer, path)

    def text(self, contents: SceneContents) -> str:
        """Return the text of the root layer without colours and names of images, for fingerprints."""
        images = [use.attribute for use in contents.uses]
        colours = [block.attribute for block in contents.blocks]
        request: TextRequest = {**self._request, "images": images, "colours": colours}
        return str(self._ask("text", request, {})[0])

    def edited(
        self, blocks: Sequence[ColourBlock], colours: Float32s | None, files: Mapping[str, str], suffix: str
    ) -> tuple[bytes, bool]:
        """Return the root layer with new colours of meshes (None: unchanged) and new files of some attributes.

        It gets the form of a suffix, or keeps its own ("") with as many bytes as possible. Also return whether the new
        values hide values of variants in other layers.
        """
        changed = [] if colours is None else [asdict(block) for block in blocks]
        request: EditRequest = {**self._request, "blocks": changed, "files": dict(files), "suffix": suffix}
        said, made = self._ask("edit", request, {} if colours is None else {"colours": colours})
        return made["layer"].tobytes(), said["hides"]

    def _fetch(self, layer: str, path: str) -> None:
        """Read a layer that another one refers to, or record that it is refused."""
        try:
            wanted = posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))
            if not wanted.lower().endswith(LAYERS):
                remedy = "write the scene as one layer (usdcat --flatten), and give that"
                raise UnfitReferenceError("is not a USD layer; only .usd, .usda and .usdc are read", remedy)
            if wanted in self.data:
                raise UnfitReferenceError("names a layer in a way that is not understood")
            file = self.folder.locate(wanted)
            if file not in self.data:
                self.data[file] = self.folder.read(file)
        except UnfitReferenceError as error:
            self.refused[layer, path] = error.obstacle
        except OSError as error:
            self.refused[layer, path] = Obstacle(f"cannot be read ({error.strerror})")
        most, size = self.access.memory, sum(map(len, self.data.values()))
        if len(self.data) > _MAX_LAYERS or (most is not None and size > most):
            raise MemoryLimitError(self.name, "it has more layers than fit into memory", "raise --max-memory")

    @property
    def _request(self) -> SceneRequest:
        return {"root": self.root, "layers": list(self.data), "refused": list(self.refused)}

    def _ask(self, task: str, request: SceneRequest, arrays: dict[str, Array]) -> Message:
        """Send a request to usd-core, with all layers in a folder, and return its answer."""
        with writing_temporary_files(), temporary_folder() as folder:
            for name, data in self.data.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
            question = {**request, "task": task, "folder": str(folder)}, arrays
            size = sum(map(len, self.data.values()))
            return _USD_CORE.ask(question, self.name, size, self.access.memory)


def binary_layer(text: bytes, name: str) -> bytes:
    """Convert a layer from text to USDC."""
    with temporary_folder() as folder:
        question = {"task": "convert", "folder": str(folder)}, {"text": np.frombuffer(text, np.uint8)}
        return _USD_CORE.ask(question, name, len(text), None)[1]["layer"].tobytes()
