"""Guides: attributes of vertices, other slots of materials, or files with a number for each sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.manifolds.guides import Guide, centred
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.paths import is_there
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.layers.pixel_colours import PixelColours
from beltrami_cli.layers.sample_files import read_map, read_table
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.atlas import Atlas
from beltrami_cli.surface.lookups import look_up
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import Texture, TexturedSurface
from beltrami_cli.surface.slots import SLOTS, Slot

# Values of a slot without a texture (glTF 2.0, section 3.9); a normal is perpendicular to the surface.
_VALUES_WITHOUT_TEXTURE = {"normal": (0.5, 0.5, 1.0), "emissive": (0.0, 0.0, 0.0)}


def vertex_guides(document: Document, settings: SmoothSettings) -> list[Guide]:
    """Read all guides for the vertex colours of a document."""
    wanted = settings.embedding.weighted_guides
    return [Guide(name, centred(_values(document, name)), beta) for name, beta in wanted]


def _values(document: Document, name: str) -> Float64s:
    known = document.attributes()
    if name.lower() in {attribute.lower() for attribute in known}:
        values = document.attribute(name)
        require_single(values, document.name, "its vertex")
        return values
    if not _exists(name):
        attributes = ", ".join(known) or "no others"
        cause = f"no such file, and no attribute of the vertices of {document.name}, which has {attributes}"
        raise InputError(name, cause)
    return read_table(name, document)


def _exists(path: str) -> bool:
    return path == "-" or is_there(path)


def read_guide_images(
    target: DecodedImage, valid: Bools, settings: SmoothSettings, access: Access
) -> tuple[Guide, ...]:
    """Read all guides for an image, one row per pixel."""
    guides = []
    for path, beta in settings.embedding.weighted_guides:
        image = read_map(path, target, access)
        finite = np.isfinite(image).all(axis=1).reshape(valid.shape) | ~valid
        if not finite.all():
            row, column = np.unravel_index(int(np.argmin(finite)), finite.shape)
            remedy = "leave such pixels out with --mask"
            cause = f"its pixel {column},{row} is not finite, so it cannot guide there"
            raise InputError(path, cause, remedy)
        guides.append(Guide(path, image, beta))
    return tuple(guides)


@dataclass(frozen=True)
class GuidedTexels:
    """The texels for which guides are read."""

    document: Document
    surface: TexturedSurface
    images: Sequence[DecodedImage]
    atlas: Atlas
    settings: SmoothSettings

    def guides(self) -> list[Guide]:
        return [self._guide(name, beta) for name, beta in self.settings.embedding.weighted_guides]

    def _guide(self, name: str, beta: float | None) -> Guide:
        slots = {slot.lower(): slot for slot in self.document.slots()}
        if name.lower() in slots:
            slot = slots[name.lower()]
            return Guide(name, self._of_slot(slot), beta, in_chart_frame=slot == "normal")
        if not _exists(name):
            known = ", ".join(self.document.slots())
            asked = "texture in the slot" if name in SLOTS else "such file, and no slot"
            raise InputError(name, f"no {asked}; the slots of {self.document.name} are {known}")
        return Guide(name, self._of_file(name), beta)

    def _of_file(self, path: str) -> Float32s:
        if len(self.images) != 1:
            names = ", ".join(texture.name for texture in self.surface.textures)
            raise UsageError(
                f"{path} guides one texture, but several are smoothed ({names}); choose one by --texture or --material"
            )
        values = read_map(path, self.images[0], self.document.access)[self.atlas.owned_texels]
        require_single(values, path, "its pixel")
        return values

    def _of_slot(self, slot: Slot) -> Float32s:
        """Read the values of another slot at each owned texel."""
        guiding = self.document.textured(slot)
        images = [read_texture(texture) for texture in guiding.textures]
        colours = PixelColours.of(images, slot, SmoothSettings(space=self.settings.space))
        width = len(colours.names)
        values = np.empty((len(self.atlas.owned_texels), width), np.float32)
        for index, inside, texels in self.atlas.by_texture(self.atlas.owned_texels):
            shown = self._texture_at_same_faces(index, guiding, slot)
            if shown is None:
                values[inside] = np.resize(_VALUES_WITHOUT_TEXTURE.get(slot, (1.0,)), width)
                continue
            shape, size = images[shown].pixels.shape[:2], self.images[index].pixels.shape[:2]
            image = colours.working(images[shown], np.arange(shape[0] * shape[1])).reshape(*shape, width)
            values[inside] = _at_size(image, size, guiding.textures[shown], texels)
        return values

    def _texture_at_same_faces(self, index: int, guiding: TexturedSurface, slot: Slot) -> int | None:
        """Return the texture of the guiding slot on the triangles of a smoothed texture; None if it has none."""
        faces = np.flatnonzero(self.surface.texture_of == index)
        name = self.surface.textures[index].name
        if len(guiding.faces) != len(self.surface.faces):
            cause = f"only one of the textures in the slots of {name} and {slot} is in tiles"
            raise InputError(self.document.name, f"{cause}, so {slot} cannot guide it", "leave the guide out")
        shown = np.unique(guiding.texture_of[faces])
        if len(shown) > 1:
            raise InputError(
                self.document.name,
                f"{name} is shown with several {slot} textures, or with one in places only, so {slot} cannot guide it",
                "choose other textures by --texture or --material",
            )
        if not len(shown) or shown[0] < 0:
            return None
        if not np.array_equal(guiding.uv[faces], self.surface.uv[faces]):
            raise InputError(
                self.document.name,
                f"{name} and its {slot} texture have different texture coordinates, so {slot} cannot guide it",
                "bake both to the same coordinates",
            )
        return int(shown[0])


def _at_size(image: Float32s, size: tuple[int, ...], texture: Texture, texels: Int64s) -> Float32s:
    """Sample an image at the centres of texels of an image, which may have another size."""
    if image.shape[:2] == size:
        return image.reshape(-1, image.shape[2])[texels]
    row, column = np.divmod(texels, size[1])
    uv = np.column_stack([(column + 0.5) / size[1], (row + 0.5) / size[0]])
    return np.asarray(look_up(image, uv, texture.wrap), np.float32)
