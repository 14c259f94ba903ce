"""The colours of a document that noise is added to, which of them share a change, and the way back.

Samples at one place have one random number, so that split vertices stay equal, and seams stay invisible.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.canvas import painted as on_canvas
from beltrami_cli.flow.embedding import from_space, to_space
from beltrami_cli.flow.parameters import Space
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import noise_losses
from beltrami_cli.layers.image_layer import ImageLayer, written
from beltrami_cli.layers.layer import Change, Layer, Repainted, rewritten
from beltrami_cli.layers.settings import COLOUR_SLOTS, SLOTS
from beltrami_cli.layers.texel_colours import Repainting, all_texel_colours
from beltrami_cli.layers.texture_layer import TextureLayer, painter_of
from beltrami_cli.layers.vertex_layer import PaintedLayer, coloured_rows
from beltrami_cli.surface.atlas import fill_gutter
from beltrami_cli.surface.baking import places_of_texels
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import ImageFile, PaintedVertices, Slot, limits_of


@dataclass(frozen=True)
class NoiseTargets:
    """Colours in the working space, and how random numbers are assigned to them."""

    colours: Float32s  # shape (K, N)
    number_of: NDArray[np.integer[Any]]  # random number of each, shape (K,); the same for all at one place
    stream: int = 0  # separates the random numbers of parts of a document
    is_grey: Bools | None = None  # where all channels are one, shape (K,); None: nowhere
    space: Space = "srgb"

    @property
    def limits(self) -> tuple[float, float]:
        """Where colours with noise are cut off."""
        return limits_of(self.colours)


def targets_of(samples: Layer) -> NoiseTargets:
    """Return the coloured vertices, covered texels or pixels."""
    space = samples.settings.space
    if isinstance(samples, PaintedLayer):
        painted, rows = samples.painted, _coloured(samples)
        colours = to_space(painted.colours[rows][:, samples.channels.changing], painted.encoding, space)
        return NoiseTargets(colours, _places(painted, rows), space=space)
    if isinstance(samples, ImageLayer):
        pixels = np.flatnonzero(samples.valid)
        colours = samples.colours.working(samples.picture, pixels)
        return NoiseTargets(colours, np.arange(len(pixels)), space=space)
    assert isinstance(samples, TextureLayer)
    # They are numbered by their place in the textures, and not on the canvas.
    atlas = samples.atlas
    number = np.empty(len(atlas.owned_texels), np.int64)
    number[np.argsort(atlas.owned_texels)] = np.arange(len(number))
    is_grey = np.array([len(picture.colour) == 1 for picture in samples.pictures], bool)
    return NoiseTargets(
        colours=all_texel_colours(samples.colours, samples.pictures, atlas),
        number_of=number,
        stream=1 + SLOTS.index(samples.slot),
        is_grey=is_grey[np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1],
        space=samples.colours.space,
    )


def positions_of(samples: Layer) -> tuple[Float64s, Float64s]:
    """Return the positions of the targets, (K, 3), and their distance from neighbours, (K,)."""
    if isinstance(samples, PaintedLayer):
        painted, rows = samples.painted, _coloured(samples)
        return painted.positions[rows], _spacing(painted, rows, _places(painted, rows))
    if isinstance(samples, ImageLayer):
        row, column = np.nonzero(samples.valid)
        return np.column_stack([column, row, np.zeros_like(row)]).astype(np.float64), np.ones(len(row))
    assert isinstance(samples, TextureLayer)
    return places_of_texels(samples.surface, samples.cells())


def coded_as_jpeg(samples: Layer, quality: int) -> Float32s:
    """Return the colours of the targets as they are after their pictures went through JPEG."""
    if isinstance(samples, PaintedLayer):
        remedy = "put the colours into a texture first: `beltrami bake --to texture`"
        raise UsageError(f"{samples.label}: JPEG codes pictures; {remedy}")
    if samples.names not in (("red", "green", "blue"), ("grey",)):
        cause = f"{samples.label}: JPEG codes all channels together; leave out --channels and --alpha"
        raise UsageError(cause)
    assert isinstance(samples, ImageLayer | TextureLayer)
    cells, space = samples.cells(), samples.colours.space
    coded = np.empty((len(cells.row), len(samples.names)), np.float32)
    for index, picture in enumerate(
        [samples.picture] if isinstance(samples, ImageLayer) else samples.pictures
    ):
        working = samples.colours.working(picture, np.arange(picture.pixels[..., 0].size))
        shown = from_space(working, "srgb", space).reshape(*picture.pixels.shape[:2], -1)
        inside, place = cells.of(index)
        coded[inside] = to_space(as_jpeg(shown, quality)[place], "srgb", space)
    return coded


def repainted(samples: Layer, targets: NoiseTargets, after: Float32s) -> Repainted:
    """Replace the colours of targets by others; colours beyond seams are shifted by the same amount."""
    if isinstance(samples, PaintedLayer):
        painted, places = samples.painted, (_coloured(samples)[:, None], samples.channels.changing)
        back = from_space(after, painted.encoding, targets.space)
        colours = painted.colours.copy()
        # Conversion to the working space and back is not exact: unchanged colours keep their bits.
        colours[places] = np.where(after != targets.colours, back, colours[places])
        return Repainted(Change.between(painted.colours, colours), colours)
    if isinstance(samples, ImageLayer):
        losses = noise_losses(samples.picture, samples.suffix, "an OUTPUT in .png keeps all")
        return written(samples, NewColours.of(after, np.flatnonzero(samples.valid)), losses)
    assert isinstance(samples, TextureLayer)
    return _repainted_textures(samples, targets, after)


def _repainted_textures(samples: TextureLayer, targets: NoiseTargets, after: Float32s) -> Repainted:
    atlas, added, wanted = samples.atlas, after - targets.colours, samples.settings.textures
    planes = on_canvas(atlas, added, threads=1)
    beyond = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, atlas.gutter_cells].T)
    new = NewColours.of(added, atlas.owned_texels, atlas.gutter_texels, beyond)
    painter, notices = painter_of(samples, wanted.gutter), list[str]()
    images: dict[tuple[Slot, str], ImageFile] = {}
    for index, (texture, picture) in enumerate(zip(samples.surface.textures, samples.pictures, strict=True)):
        pixels, is_data = _shifted(painter, index, new, targets.limits), samples.slot not in COLOUR_SLOTS
        file, said = rewritten(picture, pixels, wanted, wanted.image_suffix, as_data=is_data)
        images[samples.slot, texture.key] = file
        notices += said
        notices += noise_losses(picture, wanted.image_suffix, "--texture-format png keeps all")
    if not len(added):
        notices.append("no visible texel is covered by the surface, so its textures stay as they are")
    return Repainted(Change(), images=images, notices=tuple(notices))


def _shifted(painter: Repainting, index: int, added: NewColours, limits: tuple[float, float]) -> Array:
    """Return a picture's pixels with an offset added to its colours and gutter, within limits."""
    picture = painter.pictures[index]
    pixels, shape = picture.pixels.copy(), picture.pixels.shape[:2]
    inside, texels = painter.of_texture(added.places, index)
    change = np.zeros((*shape, added.beyond.shape[1]), np.float32)
    table = change.reshape(-1, change.shape[2])
    table[texels] = added.take(slice(None), inside)
    if painter.gutter is not None:
        covered, known, rows = painter.near_charts(index, shape, added)
        table[painter.of_texture(added.beyond_places[rows], index)[1]] = added.beyond[rows]
        fill_gutter(change, covered, painter.gutter, known)
    moved = np.flatnonzero(table.any(axis=1))
    after = (painter.colours.working(picture, moved) + table[moved]).clip(*limits)
    painter.paint(
        pixels, index, moved + painter.texture_offsets[index], lambda block, inside: after[block][inside]
    )
    return pixels


def as_jpeg(shown: Float32s, quality: int) -> Float32s:
    """Return display values of a picture, (H, W, 1 or 3), as they are after JPEG with colour at half the resolution."""
    coded = read_image(jpeg_file(shown, quality), "a picture").pixels
    return np.asarray(coded[..., : shown.shape[2]] / np.float32(255), np.float32)


def jpeg_file(shown: Float32s, quality: int) -> bytes:
    """Return the JPEG file of display values, (H, W, 1 or 3), with colour at half the resolution."""
    pixels = np.rint(255 * np.clip(shown, 0, 1)).astype(np.uint8)
    new = new_picture(np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3))), "a picture")
    new.spec.attribute("jpeg:subsampling", "4:2:0")
    picture = dataclasses.replace(new, format="jpeg", suffix=".jpg")
    return write_image(picture, new.pixels, jpeg_quality=quality).data


def _coloured(layer: PaintedLayer) -> NDArray[np.intp]:
    return coloured_rows(layer.painted, in_triangles=layer.in_triangles)


def _places(painted: PaintedVertices, rows: NDArray[np.intp]) -> Int32s:
    """Return the number of each vertex's place, shape (S,)."""
    spaces = None if painted.space_of is None else painted.space_of[rows]
    return group_places(painted.positions[rows], spaces)[0]


def _spacing(painted: PaintedVertices, rows: NDArray[np.intp], place_of: Int32s) -> Float64s:
    """Return the mean length of the sides at each vertex's place, or of points the distance to the next place."""
    count = int(place_of.max(initial=-1)) + 1
    first = np.zeros(count, np.int64)
    first[place_of] = np.arange(len(rows))
    places = painted.positions[rows[first]]
    if not len(painted.faces) and count > 1:
        from scipy.spatial import cKDTree

        apart = np.asarray(cKDTree(places).query(places, k=2)[0], np.float64)
        return np.asarray(apart[place_of, 1])
    number = np.full(len(painted.positions), -1)
    number[rows] = place_of
    corners = number[painted.faces]
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = sides[(sides >= 0).all(axis=1) & (sides[:, 0] != sides[:, 1])]
    lengths = np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1)
    total = np.bincount(sides.ravel(), np.repeat(lengths, 2), count)
    ends = np.bincount(sides.ravel(), minlength=count)
    return np.asarray((total / np.maximum(ends, 1))[place_of], np.float64)
