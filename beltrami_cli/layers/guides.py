"""Guides and known noise from files: numbers for samples that are not changed.

For vertices they are attributes, or tables with one row per vertex; for images, images of the same size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.manifolds.guides import Guide, centred
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.access import Access, is_there, read_source
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage, full_scale_one
from beltrami_cli.formats.image.reading import read_image, read_texture
from beltrami_cli.formats.image.sizes import require_memory
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.pixel_colours import PixelColours
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.atlas import Atlas, texels_by_texture
from beltrami_cli.surface.lookups import look_up
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import SLOTS, Slot, Texture, TexturedSurface

_MAX_NUMBERS = 1 << 31  # of an array, before it is known that it fits
_ONE_ROW_REMEDY = "it needs one row for each coloured vertex, in the order of the file"
# Values of a slot without a texture (glTF 2.0, section 3.9); a normal is perpendicular to the surface.
_VALUES_WITHOUT_TEXTURE = {"normal": (0.5, 0.5, 1.0), "emissive": (0.0, 0.0, 0.0)}
# Side in pixels of the squares in which the deviation of a frame is measured: 289 pixels determine it to 4 %.
_FRAME_WINDOW = 17


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


def read_table(path: str, document: Document) -> Float64s:
    """Read numbers for the vertices of a document, shape (V, G): an array, an archive of one, or vertex colours."""
    from beltrami_cli.formats.numpy_files import NPY_MAGIC, NpzArchive, is_npz, read_npy

    access, rows = document.access, len(document.coloured_vertices().positions)
    data = read_source(path, access)
    if data[: len(NPY_MAGIC)] == NPY_MAGIC:
        table = read_npy(data, path)
    elif is_npz(data) and (archive := NpzArchive(data, path)).kind() != "points":
        if len(archive.names) != 1:
            which = ", ".join(archive.names)
            raise InputError(path, f"which of its arrays {which} is meant is not clear", "save it alone")
        table = archive.array(archive.names[0], _MAX_NUMBERS)
    else:
        # The given columns belong to the points that are smoothed, not to a guide.
        guide = open_document(path, dataclasses.replace(access, columns=(), channels=()), data)
        table = guide.coloured_vertices().colours
    if table.ndim == 1:
        table = table[:, None]
    if table.ndim != 2 or table.shape[0] != rows or not table.shape[1]:
        shape = " x ".join(map(str, table.shape))
        raise InputError(
            path, f"its {shape} numbers do not fit the {rows} vertices of {document.name}", _ONE_ROW_REMEDY
        )
    numbers = table.astype(np.float64)
    require_single(numbers, path, "its row")
    return numbers


def read_map(path: str, target: DecodedImage, access: Access) -> Float32s:
    """Read numbers for the pixels of an image, shape (H * W, G)."""
    image = read_of_size(path, target, access, "recoloured")
    channels = [i for i in range(image.pixels.shape[2]) if i != image.alpha]
    numbers = np.asarray(full_scale_one(image.pixels[..., channels]), np.float32)
    return numbers.reshape(-1, numbers.shape[2])


def read_of_size(path: str, target: DecodedImage, access: Access, work: str) -> DecodedImage:
    """Read an image with the size of another; `work`: see `require_memory`."""
    data = read_source(path, access)
    require_memory([(path, data)], access, work)
    image = read_image(data, path, finite=False)
    (rows, columns), size = image.pixels.shape[:2], target.pixels.shape[:2]
    if (rows, columns) != size:
        cause = f"its {columns} x {rows} pixels do not fit the {size[1]} x {size[0]} of {target.name}"
        raise InputError(path, cause, "both must have the same size, pixel by pixel")
    return image


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
        for index, inside, texels in texels_by_texture(self.atlas.texture_offsets, self.atlas.owned_texels):
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


def noise_of_pixels(
    kernel: KernelParameters, images: Sequence[DecodedImage], pixels: Int64s | Bools, access: Access
) -> Float32s | None:
    """Read the standard deviations of all pixels, one row per pixel; None if no file is given."""
    given = kernel.given_noise
    if given is None or not given.source:
        return None
    if given.kind == "attribute":
        raise UsageError(f"noise is of the attribute {given.source}, which only vertices have; name an image")
    if len(images) != 1:
        cause = f"{given.source} is the noise of one of {len(images)} textures; choose it by --texture"
        raise UsageError(cause)
    rows = read_map(given.source, images[0], access)
    if given.kind == "frame":
        frame = rows.reshape(*images[0].pixels.shape[:2], -1)
        rows = deviation_in_frame(frame).reshape(rows.shape)
    _check(rows[pixels], given.source, "pixel")
    return rows


def noise_of_vertices(kernel: KernelParameters, document: Document) -> Float32s | None:
    """Read the standard deviations of vertices, shape (V, K); None if neither file nor attribute is given."""
    given = kernel.given_noise
    if given is None or not given.source:
        return None
    if given.kind == "frame":
        cause = f"{given.source} is a frame of pixels, but vertices are smoothed; name their deviations"
        raise UsageError(cause)
    is_attribute = given.kind == "attribute"
    values = document.attribute(given.source) if is_attribute else read_table(given.source, document)
    _check(values, given.source, "vertex")
    return values.astype(np.float32)


def deviation_in_frame(frame: Float32s) -> Float32s:
    """Return the local standard deviation of a frame without a scene, (H, W, K); its light may fall off."""
    from scipy.ndimage import uniform_filter

    size = (_FRAME_WINDOW, _FRAME_WINDOW, 1)
    residual = frame - uniform_filter(frame, size, mode="reflect")
    return np.asarray(np.sqrt(uniform_filter(np.square(residual), size, mode="reflect").clip(0)), np.float32)


def _check(deviations: Float32s | Float64s, name: str, row: str) -> None:
    require_single(deviations, name, f"its {row}")
    low, high = deviations.min(initial=0), deviations.max(initial=0)
    if low < 0 or high > 1:
        extreme = f"down to {low:g}" if low < 0 else f"up to {high:g}"
        cause = f"its values go {extreme}, but standard deviations are from 0 to a full scale of 1"
        raise InputError(name, cause, "divide them by 255 if they are of 255")
