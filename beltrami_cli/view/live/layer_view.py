"""Coloured parts of a document on the page of the live view, and how their new colours are sent there."""

from __future__ import annotations

import base64
from functools import cached_property
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s, Uint8s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.records import Slot
from beltrami_cli.view.light import displayed_colours, displayed_pixels
from beltrami_cli.view.live.previews import Focus, Steps, Update, previewer_of
from beltrami_cli.view.pages.images import image_of, textures_of
from beltrami_cli.view.pages.models import ModelWriter
from beltrami_cli.view.pages.rendering import packed_array

_COMPRESSION_LEVEL = 1  # of zlib


class LayerView:
    """The textures of a `slot`, or (None) vertices or pixels: the layer of a `number` on all open pages.

    It is added to the model of the page, with equal colours before and after.
    """

    def __init__(self, document: Document, slot: Slot | None, writer: ModelWriter, number: int = 0) -> None:
        self.slot, self._document, self._number = slot, document, number
        self._previewer = previewer_of(document, slot)
        self._is_image = document.kind == "image"
        self._placement = writer.add((document, document), slot)
        self._can_move = False  # whether vertices have moved, on any page
        # Pixels sent last, by texture, if they differ from the document.
        self._shown: dict[int, Uint8s] = {}

    @cached_property
    def _positions(self) -> Float64s:
        return self._document.coloured_vertices().positions

    def preview(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Steps | None
    ) -> tuple[list[dict[str, Any]], int]:
        """Smooth about `budget` samples around the focus, in the box of the model; return updates and samples."""
        if focus.direction is not None and self._placement is not None:
            box = self._placement.box
            focus = Focus(box.low + box.size * focus.origin, focus.direction)
        updates = self._previewer.smooth(settings, focus, budget, progress)
        return [self._packed(update) for update in updates], sum(len(update.rows) for update in updates)

    def whole(self, result: Document) -> list[dict[str, Any]]:
        """Return the updates that show the part of a result."""
        self._shown.clear()
        if self.slot is None and not self._is_image:
            vertices = result.coloured_vertices()
            rows = np.arange(len(vertices.positions))
            self._can_move |= not np.array_equal(vertices.positions, self._positions, equal_nan=True)
            positions = vertices.positions if self._can_move else None
            return [self._packed(Update(-1, rows, rows, displayed_colours(vertices), positions))]
        found = []
        textures = zip(textures_of(self._document, self.slot), textures_of(result, self.slot), strict=True)
        for index, (before, after) in enumerate(textures):
            if after.data != before.data:
                self._shown[index] = self._displayed(result, index)
            mime, data = image_of(after, self.slot or "baseColor", result.image if self._is_image else None)
            source = f"data:{mime};base64,{base64.b64encode(data).decode()}"
            found.append({"layer": self._number, "texture": index, "source": source})
        return found

    def _packed(self, update: Update) -> dict[str, Any]:
        packed = self._packed_vertices(update) if update.texture < 0 else self._packed_texels(update)
        return {"layer": self._number, **packed}

    def _packed_vertices(self, update: Update) -> dict[str, Any]:
        assert self._placement is not None
        assert self._placement.row_of is not None
        rows = self._placement.row_of[update.rows]
        drawn = rows >= 0  # points without a position are not drawn
        arrays = {"rows": rows.astype(np.uint32), "colours": update.colours}
        if update.positions is not None:
            arrays["places"] = self._placement.box.shares(update.positions).astype(np.float32)
        return {name: packed_array(values[drawn], _COMPRESSION_LEVEL) for name, values in arrays.items()}

    def _packed_texels(self, update: Update) -> dict[str, Any]:
        """Return the bounding rectangle of texels, and record their new pixels."""
        if update.texture not in self._shown:
            self._shown[update.texture] = self._displayed(self._document, update.texture)
        pixels = self._shown[update.texture]
        pixels[update.rows, update.columns] = update.colours
        top, left = int(update.rows.min()), int(update.columns.min())
        part = pixels[top : int(update.rows.max()) + 1, left : int(update.columns.max()) + 1]
        return {
            "texture": update.texture, "x": left, "y": top, "width": part.shape[1], "height": part.shape[0],
            "pixels": packed_array(part, _COMPRESSION_LEVEL),
        }  # fmt: skip

    def _displayed(self, document: Document, index: int) -> Uint8s:
        if self._is_image:
            return displayed_pixels(document.image())
        return displayed_pixels(read_texture(textures_of(document, self.slot)[index]))
