"""The layers of a document in the live view: its vertex colours, the textures of each slot, or an image."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from beltrami_cli.arrays import Int64s, Uint8s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.surface.records import Slot, Texture
from beltrami_cli.view.models import (
    Box,
    ModelWriter,
    displayed_colours,
    displayed_pixels,
    image_of,
    packed_array,
)
from beltrami_cli.view.preview import Focus, Patch

# Pixels as a page shows them, by layer and texture, where they differ from the document.
Shown = dict[tuple[int, int], Uint8s]

_QUICK = 1  # of zlib


class Layers:
    """The coloured parts of a document: `slots` of its textures, and None for vertex colours or an image."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self._is_image = document.kind == "image"
        slots: list[Slot | None] = [] if self._is_image else [*document.slots()]
        self.slots = [*slots, None] if self._is_image or document.has_vertex_colours() else slots
        self._row_of: Int64s | None = None
        self._has_moved = False  # vertices, on the page
        self._boxes: list[Box] = []

    def glb(self, reach: float) -> bytes:
        """Return the document for the viewer, with the same before and after."""
        writer = ModelWriter(is_live=True)
        for slot in self.slots:
            writer.add((self.document, self.document), slot)
        self._row_of, self._boxes = writer.row_of, writer.boxes
        return writer.glb(reach)

    def in_space(self, focus: Focus, layer: int) -> Focus:
        """Return a focus in the space of the document, where its page has it in the box of the model."""
        if focus.direction is None:
            return focus
        box = self._boxes[layer]
        return Focus(box.low + box.size * focus.origin, focus.direction)

    def patched(self, shown: Shown, layer: int, patch: Patch) -> dict[str, Any]:
        """Return a patch for the viewer, and keep what a texture looks like with it."""
        if patch.texture < 0:
            assert self._row_of is not None
            rows = self._row_of[patch.rows]
            drawn = rows >= 0  # points that are nowhere are not
            kept = {"rows": rows.astype(np.uint32), "colours": patch.colours}
            if patch.places is not None:
                kept["places"] = self._boxes[layer].shares(patch.places).astype(np.float32)
            return {"layer": layer, **{name: packed_array(own[drawn], _QUICK) for name, own in kept.items()}}
        pixels = self._pixels(shown, layer, patch.texture)
        pixels[patch.rows, patch.columns] = patch.colours
        top, left = int(patch.rows.min()), int(patch.columns.min())
        part = pixels[top : int(patch.rows.max()) + 1, left : int(patch.columns.max()) + 1]
        return {
            "layer": layer, "texture": patch.texture, "x": left, "y": top,
            "width": part.shape[1], "height": part.shape[0], "pixels": packed_array(part, _QUICK),
        }  # fmt: skip

    def _pixels(self, shown: Shown, layer: int, texture: int) -> Uint8s:
        key = layer, texture
        if key not in shown:
            file, is_image = _textures_of(self.document, self.slots[layer])[texture], self._is_image
            shown[key] = displayed_pixels(read_image(file.data, file.name, finite=not is_image))
        return shown[key]

    def whole(self, shown: Shown, result: Document) -> list[dict[str, Any]]:
        shown.clear()
        return [patch for layer in range(len(self.slots)) for patch in self._smoothed(shown, result, layer)]

    def _smoothed(self, shown: Shown, result: Document, layer: int) -> list[dict[str, Any]]:
        slot = self.slots[layer]
        if slot is None and not self._is_image:
            painted = result.painted()
            rows = np.arange(len(painted.positions))
            unmoved = self.document.painted().positions
            is_moved = not np.array_equal(painted.positions, unmoved, equal_nan=True)
            places = painted.positions if is_moved or self._has_moved else None
            self._has_moved = is_moved
            return [self.patched(shown, layer, Patch(-1, rows, rows, displayed_colours(painted), places))]
        old, new = _textures_of(self.document, slot), _textures_of(result, slot)
        found = []
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            if after.data != before.data:
                picture = read_image(after.data, after.name, finite=not self._is_image)
                shown[layer, index] = displayed_pixels(picture)
            mime, data = image_of(after, slot or "baseColor")
            source = f"data:{mime};base64,{base64.b64encode(data).decode()}"
            found.append({"layer": layer, "texture": index, "source": source})
        return found


def _textures_of(document: Document, slot: Slot | None) -> tuple[Texture, ...]:
    """Return the textures of a layer; an image is one."""
    if document.kind == "image":
        return (Texture("", document.name, document.data),)
    assert slot is not None
    return document.textured(slot).textures
