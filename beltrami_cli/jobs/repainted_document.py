"""A document with new colours, to be looked at before, or instead of, being written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, NoReturn

import numpy as np

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.formats.colours import quantised
from beltrami_cli.formats.document import Changes, Document, Naming
from beltrami_cli.formats.image_document import ImageDocument
from beltrami_cli.layers.layer import Repainted, all_images
from beltrami_cli.surface.records import MeshContents, PaintedVertices, Slot, TexturedSurface


def with_new_colours(document: Document, painted: Sequence[Repainted]) -> Document:
    """Return what a document would be with new colours, rounded to what its file holds of them."""
    images = {key: image.data for key, image in all_images(painted)[0].items()}
    vertices = next((each for each in painted if each.colours is not None), None)
    if document.kind == "image":
        return ImageDocument(images.get(("baseColor", ""), document.data), document.name)
    return RepaintedDocument(document, None if vertices is None else _rounded(document, vertices), images)


def _rounded(document: Document, new: Repainted) -> PaintedVertices:
    painted, colours = document.painted(), new.colours
    assert colours is not None
    if painted.stored.startswith(("uint", "int")):
        full = painted.full_scale
        colours = (quantised(colours, painted.stored, full) / full).astype(np.float32)
    return replace(
        painted, colours=colours, positions=painted.positions if new.positions is None else new.positions
    )


class RepaintedDocument(Document):
    """A model with other vertex colours and image files than its source; the rest is delegated to the source."""

    format: ClassVar[str] = "repainted"

    def __init__(
        self, source: Document, vertices: PaintedVertices | None, images: Mapping[tuple[Slot, str], bytes]
    ) -> None:
        super().__init__(source.data, source.name, None, source.access)
        self._source, self._vertices, self._images = source, vertices, images
        self.kind = source.kind  # type: ignore[misc]

    def painted(self) -> PaintedVertices:
        return self._source.painted() if self._vertices is None else self._vertices

    def grid(self) -> Int64s | None:
        return self._source.grid()

    def attributes(self) -> tuple[str, ...]:
        return self._source.attributes()

    def attribute(self, name: str) -> Float64s:
        return self._source.attribute(name)

    def contents(self) -> MeshContents:
        return self._source.recoloured_contents(None if self._vertices is None else self._vertices.colours)

    def slots(self) -> tuple[Slot, ...]:
        return self._source.slots()

    def _gathered(self, slot: Slot) -> TexturedSurface:
        surface = self._source.textured(slot)
        textures = [
            replace(each, content=self._images.get((slot, each.key), each.content))
            for each in surface.textures
        ]
        return replace(surface, textures=tuple(textures))

    def _patched(self, new: Changes, naming: Naming) -> NoReturn:
        raise NotImplementedError("it is not written")

    def facts(self) -> dict[str, object]:
        return self._source.facts()
