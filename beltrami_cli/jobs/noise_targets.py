"""The colours of a document that noise is added to, which of them share a change, and the way back.

Samples at one place have one random number, so that split vertices stay equal, and seams stay invisible.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.canvas import painted as on_canvas
from beltrami_cli.flow.embedding import from_space, to_space
from beltrami_cli.flow.parameters import Space
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.image import Picture, write_image
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
from beltrami_cli.surface.baking import Cells, places_of_texels
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


@dataclass(frozen=True)
class NoisyLayer:
    """What adding noise needs of a layer."""

    what: str  # the name of its colours in reports
    targets: NoiseTargets
    # The positions of the targets, (K, 3), and their distance from neighbours, (K,).
    positions: Callable[[], tuple[Float64s, Float64s]]
    # Replace the colours of the targets by others; colours beyond seams are shifted by the same amount.
    repainted: Callable[[Float32s], Repainted]
    # Return the colours of the targets as they are after their pictures went through JPEG of a quality.
    coded_as_jpeg: Callable[[int], Float32s]
    cells: Callable[[], Cells | None] = lambda: None  # where the targets lie in pictures, if they do


@singledispatch
def noisy_layer(layer: Layer) -> NoisyLayer:
    """Prepare a layer for noise, by its kind."""
    raise UsageError(f"{layer.label}: noise cannot be added to such colours")


@noisy_layer.register
def _(layer: PaintedLayer) -> NoisyLayer:
    painted, space, changing = layer.painted, layer.settings.space, layer.channels.changing
    rows = coloured_rows(painted, in_triangles=layer.in_triangles)
    spaces = None if painted.space_of is None else painted.space_of[rows]
    place_of, _ = group_places(painted.positions[rows], spaces)
    before = to_space(painted.colours[rows][:, changing], painted.encoding, space)

    def positions() -> tuple[Float64s, Float64s]:
        return painted.positions[rows], _spacing(painted, rows, place_of)

    def repainted(after: Float32s) -> Repainted:
        colours, places = painted.colours.copy(), (rows[:, None], changing)
        # Conversion to the working space and back is not exact: unchanged colours keep their bits.
        back = from_space(after, painted.encoding, space)
        colours[places] = np.where(after != before, back, colours[places])
        return Repainted(Change.between(painted.colours, colours), colours)

    def coded_as_jpeg(_: int) -> Float32s:
        remedy = "put the colours into a texture first: `beltrami bake --to texture`"
        raise UsageError(f"{layer.label}: JPEG codes pictures; {remedy}")

    targets = NoiseTargets(before, place_of, space=space)
    return NoisyLayer("vertex colours", targets, positions, repainted, coded_as_jpeg)


@noisy_layer.register
def _(layer: ImageLayer) -> NoisyLayer:
    before = layer.unchanged()

    def positions() -> tuple[Float64s, Float64s]:
        row, column = np.nonzero(layer.valid)
        return np.column_stack([column, row, np.zeros_like(row)]).astype(np.float64), np.ones(len(row))

    def repainted(after: Float32s) -> Repainted:
        losses = noise_losses(layer.picture, layer.suffix, "an OUTPUT in .png keeps all")
        return written(layer, NewColours.of(after, before.places), losses)

    targets = NoiseTargets(before.table(), np.arange(len(before.places)), space=layer.settings.space)
    coded = partial(_coded_as_jpeg, layer, [layer.picture])
    return NoisyLayer(layer.label, targets, positions, repainted, coded, layer.places)


@noisy_layer.register
def _(layer: TextureLayer) -> NoisyLayer:
    atlas = layer.atlas
    # Texels are numbered by their place in the textures, and not on the canvas.
    number = np.empty(len(atlas.owned_texels), np.int64)
    number[np.argsort(atlas.owned_texels)] = np.arange(len(number))
    is_grey = np.array([len(picture.colour) == 1 for picture in layer.pictures], bool)
    targets = NoiseTargets(
        colours=all_texel_colours(layer.colours, layer.pictures, atlas),
        number_of=number,
        stream=1 + SLOTS.index(layer.slot),
        is_grey=is_grey[np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1],
        space=layer.colours.space,
    )

    def positions() -> tuple[Float64s, Float64s]:
        return places_of_texels(layer.surface, layer.places())

    repainted, coded = partial(_repainted, layer, targets), partial(_coded_as_jpeg, layer, layer.pictures)
    return NoisyLayer(layer.label, targets, positions, repainted, coded, layer.places)


def _repainted(layer: TextureLayer, targets: NoiseTargets, after: Float32s) -> Repainted:
    atlas, added, wanted = layer.atlas, after - targets.colours, layer.settings.textures
    planes = on_canvas(atlas, added, threads=1)
    beyond = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, atlas.gutter_cells].T)
    new = NewColours.of(added, atlas.owned_texels, atlas.gutter_texels, beyond)
    painter, notices = painter_of(layer, wanted.gutter), list[str]()
    images: dict[tuple[Slot, str], ImageFile] = {}
    for index, (texture, picture) in enumerate(zip(layer.surface.textures, layer.pictures, strict=True)):
        pixels, is_data = _shifted(painter, index, new, targets.limits), layer.slot not in COLOUR_SLOTS
        file, said = rewritten(picture, pixels, wanted, wanted.image_suffix, as_data=is_data)
        images[layer.slot, texture.key] = file
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


def _coded_as_jpeg(
    layer: ImageLayer | TextureLayer, pictures: Sequence[Picture], quality: int
) -> Float32s:  # fmt: skip
    if layer.names not in (("red", "green", "blue"), ("grey",)):
        cause = f"{layer.label}: JPEG codes all channels together; leave out --channels and --alpha"
        raise UsageError(cause)
    cells, space = layer.places(), layer.colours.space
    coded = np.empty((len(cells.row), len(layer.names)), np.float32)
    for index, picture in enumerate(pictures):
        working = layer.colours.working(picture, np.arange(picture.pixels[..., 0].size))
        shown = from_space(working, "srgb", space).reshape(*picture.pixels.shape[:2], -1)
        inside, place = cells.of(index)
        coded[inside] = to_space(as_jpeg(shown, quality)[place], "srgb", space)
    return coded


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
