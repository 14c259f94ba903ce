"""Models for the viewer of a report: triangles, colours and images, packed for a browser."""

from __future__ import annotations

import base64
import hashlib
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.view.pages import data_address, script_json
from beltrami_cli.view.views import disc_radii, light_of, texture_sheet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import PaintedVertices, Slot, Texture, TexturedSurface

_MIME = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}


class ModelPacker:
    """Collects what models consist of, with equal arrays once; `box`, (2, 3), is centred and scaled to a size of 1."""

    def __init__(self, box: NDArray[np.float64]) -> None:
        self._middle = box.mean(axis=0)
        self._size = max(float(np.ptp(box, axis=0).max()), np.finfo(float).tiny)
        self._buffers: dict[str, str] = {}
        self._textures: list[dict[str, Any]] = []
        self._models: list[list[dict[str, Any]]] = []

    def add(self, document: Document, slot: Slot | None) -> None:
        """Add a model with the textures of a slot, or with its vertex colours."""
        if slot is None:
            self._models.append(self._painted(document.painted()))
        else:
            self._models.append(self._textured(document.textured(slot), slot))

    def as_json(self) -> str:
        """Return everything as JSON that can stand in a script element."""
        everything = {"buffers": self._buffers, "textures": self._textures, "models": self._models}
        return script_json(everything)

    def _painted(self, painted: PaintedVertices) -> list[dict[str, Any]]:
        light = np.rint(light_of(painted) * 65535).astype(np.uint16)
        finite = np.isfinite(painted.positions).all(axis=1)
        if len(painted.faces):
            return [
                {
                    "kind": "mesh", "texture": None, "colour": self._kept(light),
                    "position": self._places(painted.positions), "index": self._kept(painted.faces.astype(np.uint32)),
                }
            ]  # fmt: skip
        size = 2 * float(np.median(disc_radii(painted.positions[finite]))) / self._size
        places, colours = self._places(painted.positions[finite]), self._kept(light[finite])
        return [{"kind": "points", "texture": None, "colour": colours, "position": places, "size": size}]

    def _textured(self, surface: TexturedSurface, slot: Slot) -> list[dict[str, Any]]:
        first = len(self._textures)
        self._textures += [_packed(texture, slot) for texture in surface.textures]
        parts = []
        for number in np.unique(surface.texture_of).tolist():
            mine = surface.texture_of == number
            parts.append(
                {
                    "kind": "mesh",
                    "texture": None if number < 0 else first + number,
                    "position": self._places(surface.positions[surface.faces[mine]].reshape(-1, 3)),
                    "uv": None if number < 0 else self._kept(surface.uv[mine].astype(np.float32)),
                }
            )
        return parts

    def _places(self, positions: NDArray[np.float64]) -> str:
        return self._kept(np.asarray((positions - self._middle) / self._size, np.float32))

    def _kept(self, values: NDArray[Any]) -> str:
        data = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()
        key = hashlib.sha256(data).hexdigest()[:16]
        self._buffers[key] = base64.b64encode(data).decode()
        return key


def bounding_box(document: Document, slot: Slot | None) -> NDArray[np.float64]:
    """Return the least and greatest coordinates of a model, (2, 3)."""
    positions = document.painted().positions if slot is None else document.textured(slot).positions
    positions = positions[np.isfinite(positions).all(axis=1)]
    return np.stack([positions.min(axis=0), positions.max(axis=0)])


def _packed(texture: Texture, slot: Slot) -> dict[str, Any]:
    """Return a texture as it is if browsers show its format, or else as PNG."""
    mime = next((mime for mark, mime in _MIME.items() if texture.data.startswith(mark)), None)
    if mime is not None:
        source = f"data:{mime};base64,{base64.b64encode(texture.data).decode()}"
    else:
        sheet = texture_sheet(texture, slot)
        shown = np.concatenate([linear_to_srgb(sheet[..., :3]), sheet[..., 3:]], axis=2)
        source = data_address(np.rint(255 * shown).astype(np.uint8))
    return {"source": source, "wrap": texture.wrap, "hides": texture.alpha_hides}
