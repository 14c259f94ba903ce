"""Coloured parts of a document on the page of the live view, and how their new colours are sent there."""

from __future__ import annotations

import base64
from functools import cached_property
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s, Uint8s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import read_texture
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.records import Slot
from beltrami_cli.view.light import displayed_colours, displayed_pixels
from beltrami_cli.view.models import ModelWriter, Placement
from beltrami_cli.view.page_images import image_of, textures_of
from beltrami_cli.view.pages import packed_array
from beltrami_cli.view.preview import Focus, Patch, Progress, previewer_of

_COMPRESSION_LEVEL = 1  # of zlib


class LayerView:
    """The textures of a `slot`, or (None) vertices or pixels: the layer of a `number` on all open pages."""

    def __init__(self, document: Document, slot: Slot | None, number: int = 0) -> None:
        self.slot, self._document, self._number = slot, document, number
        self._previewer = previewer_of(document, slot)
        self._is_image = document.kind == "image"
        self._placement: Placement | None = None  # in the model of the page; None: an image
        self._can_move = False  # whether vertices have moved, on any page
        # Pixels sent last, by texture, if they differ from the document.
        self._shown: dict[int, Uint8s] = {}

    @cached_property
    def _positions(self) -> Float64s:
        return self._document.coloured_vertices().positions

    def add_to(self, writer: ModelWriter) -> None:
        """Add the part to a model for the viewer, with equal colours before and after."""
        self._placement = writer.add((self._document, self._document), self.slot)

    def preview(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> tuple[list[dict[str, Any]], int]:
        """Smooth about `budget` samples around the focus, in the box of the model; return patches and samples."""
        if focus.direction is not None and self._placement is not None:
            box = self._placement.box
            focus = Focus(box.low + box.size * focus.origin, focus.direction)
        patches = self._previewer.smooth(settings, focus, budget, progress)
        return [self._packed(patch) for patch in patches], sum(len(patch.rows) for patch in patches)

    def whole(self, result: Document) -> list[dict[str, Any]]:
        """Return the patches that show the part of a result."""
        self._shown.clear()
        if self.slot is None and not self._is_image:
            vertices = result.coloured_vertices()
            rows = np.arange(len(vertices.positions))
            self._can_move |= not np.array_equal(vertices.positions, self._positions, equal_nan=True)
            positions = vertices.positions if self._can_move else None
            return [self._packed(Patch(-1, rows, rows, displayed_colours(vertices), positions))]
        found = []
        textures = zip(textures_of(self._document, self.slot), textures_of(result, self.slot), strict=True)
        for index, (before, after) in enumerate(textures):
            if after.data != before.data:
                self._shown[index] = self._displayed(result, index)
            mime, data = image_of(after, self.slot or "baseColor", result.image if self._is_image else None)
            source = f"data:{mime};base64,{base64.b64encode(data).decode()}"
            found.append({"layer": self._number, "texture": index, "source": source})
        return found

    def _packed(self, patch: Patch) -> dict[str, Any]:
        packed = self._packed_vertices(patch) if patch.texture < 0 else self._packed_texels(patch)
        return {"layer": self._number, **packed}

    def _packed_vertices(self, patch: Patch) -> dict[str, Any]:
        assert self._placement is not None
        assert self._placement.row_of is not None
        rows = self._placement.row_of[patch.rows]
        drawn = rows >= 0  # points without a position are not drawn
        arrays = {"rows": rows.astype(np.uint32), "colours": patch.colours}
        if patch.positions is not None:
            arrays["places"] = self._placement.box.shares(patch.positions).astype(np.float32)
        return {name: packed_array(values[drawn], _COMPRESSION_LEVEL) for name, values in arrays.items()}

    def _packed_texels(self, patch: Patch) -> dict[str, Any]:
        """Return the bounding rectangle of texels, and record their new pixels."""
        if patch.texture not in self._shown:
            self._shown[patch.texture] = self._displayed(self._document, patch.texture)
        pixels = self._shown[patch.texture]
        pixels[patch.rows, patch.columns] = patch.colours
        top, left = int(patch.rows.min()), int(patch.columns.min())
        part = pixels[top : int(patch.rows.max()) + 1, left : int(patch.columns.max()) + 1]
        return {
            "texture": patch.texture, "x": left, "y": top, "width": part.shape[1], "height": part.shape[0],
            "pixels": packed_array(part, _COMPRESSION_LEVEL),
        }  # fmt: skip

    def _displayed(self, document: Document, index: int) -> Uint8s:
        if self._is_image:
            return displayed_pixels(document.image())
        return displayed_pixels(read_texture(textures_of(document, self.slot)[index]))
