"""Add noise to the colours of a file: for tests, and to show what smoothing takes away again.

Samples at one place have one random number, so that split vertices stay equal, and seams stay invisible.
Noise of samples by themselves is a function of a colour and of a uniform random number of the sample: the inverse of a
distribution function. So samples with one colour and one number change equally, and samples at one place with different
colours change in the same direction. A camera counts photons in linear light, which makes a variance of A L + B^2, and
in pictures through a Bayer mosaic that is demosaiced chart by chart, bilinearly. Grain is a function of the place in
space: random numbers on a lattice, mixed linearly between its points and divided by the deviation of the mixture.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import ProcessingError, UsageError
from beltrami_cli.flow.manifolds.canvas import on_canvas
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.parameters import Space
from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import noise_losses
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.recolour import ColourFilter, FileReport, FilterResult, recolour
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.layer import Layer, StoredColours
from beltrami_cli.layers.picture_layer import PictureLayer
from beltrami_cli.layers.settings import DEFAULTS, SLOTS, SmoothSettings
from beltrami_cli.layers.texture_layer import TextureLayer, all_texel_colours
from beltrami_cli.layers.vertex_layer import VertexLayer, change_of, coloured_rows
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.baking import Cells, places_of_texels
from beltrami_cli.surface.colour_values import from_space, limits_of, to_space
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import ColouredVertices

_BAYER = np.array([[0, 1], [1, 2]])  # the channel that is measured, by row and column
_LATTICE = 1 << 16  # random numbers, which points of a lattice share by a hash


@dataclass(frozen=True)
class Added:
    """What noise changed: which colours, how many samples, and the root mean square change in the file."""

    what: str
    samples: int
    rms: float


@dataclass(frozen=True, kw_only=True)
class NoiseReport(FileReport):
    """What was done to a file.

    Attributes
    ----------
    added : list
        For each kind of colours "what" they are, how many "samples", and the "rms" change, full scale 1.
    input, output, format, parameters, stages, peak_memory, written, warnings
        As for `SmoothReport`.
    """

    added: list[Added]


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


@dataclass(frozen=True, kw_only=True)
class Noisy(FilterResult):
    """Samples with noise, and what it changed."""

    added: Added


@dataclass(frozen=True)
class Noising(ColourFilter[Noisy]):
    """A filter that adds noise."""

    works_in_files: ClassVar[bool] = False
    noise: NoiseSettings

    @property
    def changes(self) -> bool:
        return self.noise.sigma != 0

    def apply(self, layer: Layer, job: Job) -> Noisy:
        del job
        targets = _targets_of(layer)
        after = _with_noise(layer, targets, self.noise)
        made = _stored(layer, targets, after)
        what = "vertex colours" if isinstance(layer, VertexLayer) else layer.label
        return Noisy(stored=made, added=Added(what, len(after), made.change.summary()["rms"]))

    def check_results(self, source: str, results: Sequence[Noisy]) -> None:
        changes = [each.stored.change for each in results]
        if any(each.count for each in changes) and not any(each.largest for each in changes):
            remedy = "add more, or choose a format without loss"
            raise ProcessingError(f"nothing of the noise would be left in the file; {remedy}", source)


def noise_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    noise: NoiseSettings,
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
) -> NoiseReport:
    """Add noise to the selected colours of a model, points, a level set or an image, and change nothing else.

    Parameters
    ----------
    source, target : path
        As for `smooth_file`.
    noise : NoiseSettings
        Its kind, how much, and the seed.
    settings : SmoothSettings
        Which colours, and how textures are written; the kernel does not matter.
    job : Job
        What may be read, and whether files are written and replaced.

    Returns
    -------
    NoiseReport
        What was changed by how much, and the files that were written.

    Raises
    ------
    UsageError, InputError, OutputError
        As for `smooth_file`.
    """
    made, noisy = recolour(os.fspath(source), os.fspath(target), settings, Noising(noise), job)
    added = [each.added for each in noisy]
    return NoiseReport(**{**vars(made), "parameters": dataclasses.asdict(noise)}, added=added)


def _targets_of(layer: Layer) -> NoiseTargets:
    """Return the colours of a layer that noise is added to: of vertices, texels or pixels."""
    space = layer.settings.space
    if isinstance(layer, VertexLayer):
        vertices, rows = layer.vertices, _rows_of(layer)
        before = to_space(vertices.colours[rows][:, layer.channels.changing], vertices.encoding, space)
        return NoiseTargets(before, _places_of(vertices, rows), space=space)
    if isinstance(layer, ImageLayer):
        before = layer.colours.working(layer.picture, np.flatnonzero(layer.valid))
        return NoiseTargets(before, np.arange(len(before)), space=space)
    assert isinstance(layer, TextureLayer)
    atlas = layer.atlas
    # Texels are numbered by their place in the textures, and not on the canvas.
    number = np.empty(len(atlas.owned_texels), np.int64)
    number[np.argsort(atlas.owned_texels)] = np.arange(len(number))
    is_grey = np.array([len(picture.colour) == 1 for picture in layer.pictures], bool)
    return NoiseTargets(
        colours=all_texel_colours(layer.colours, layer.pictures, atlas),
        number_of=number,
        stream=1 + SLOTS.index(layer.slot),
        is_grey=is_grey[np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1],
        space=layer.colours.space,
    )


def _stored(layer: Layer, targets: NoiseTargets, after: Float32s) -> StoredColours:
    """Give the targets of a layer new colours."""
    if isinstance(layer, VertexLayer):
        vertices, changing = layer.vertices, layer.channels.changing
        colours, places = vertices.colours.copy(), (_rows_of(layer)[:, None], changing)
        # Conversion to the working space and back is not exact: unchanged colours keep their bits.
        back = from_space(after, vertices.encoding, targets.space)
        colours[places] = np.where(after != targets.colours, back, colours[places])
        return StoredColours(change_of(vertices, colours), colours)
    if isinstance(layer, ImageLayer):
        new = NewColours.of(after, np.flatnonzero(layer.valid))
        remedy = "an OUTPUT in .png keeps all"
    else:
        assert isinstance(layer, TextureLayer)
        atlas = layer.atlas
        planes = on_canvas(atlas, after)
        beyond = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, atlas.gutter_cells].T)
        new = NewColours.of(after, atlas.owned_texels, atlas.gutter_texels, beyond)
        remedy = "--texture-format png keeps all"
    made = layer.encode(new)
    losses = [loss for each in layer.pictures for loss in noise_losses(each, layer.suffix, remedy)]
    return dataclasses.replace(made, notices=(*made.notices, *losses))


def _rows_of(layer: VertexLayer) -> NDArray[np.intp]:
    return coloured_rows(layer.vertices, in_triangles=layer.in_triangles)


def _places_of(vertices: ColouredVertices, rows: NDArray[np.intp]) -> Int32s:
    """Return the number of the place of each of some vertices."""
    spaces = None if vertices.space_of is None else vertices.space_of[rows]
    return group_places(vertices.positions[rows], spaces)[0]


def _with_noise(layer: Layer, targets: NoiseTargets, settings: NoiseSettings) -> Float32s:
    if not targets.colours.size or settings.sigma == 0:
        return targets.colours.copy()
    if settings.kind == "jpeg":
        return _coded_as_jpeg(layer, settings.quality)
    if settings.kind == "camera":
        where = layer.places()
        return seen_by_camera(targets, where if isinstance(where, Cells) else None, settings)
    if settings.kind == "grain":
        return add_grain(targets, *_positions_of(layer), settings)
    return add_noise(targets, settings)


def _positions_of(layer: Layer) -> tuple[Float64s, Float64s]:
    """Return the positions of the targets, (K, 3), and their distance from neighbours, (K,)."""
    if isinstance(layer, VertexLayer):
        rows = _rows_of(layer)
        return layer.vertices.positions[rows], _spacing(layer.vertices, rows)
    cells = layer.places()
    assert isinstance(cells, Cells)
    if isinstance(layer, TextureLayer):
        return places_of_texels(layer.surface, cells)
    places = np.column_stack([cells.column, cells.row, np.zeros_like(cells.row)])
    return places.astype(np.float64), np.ones(len(places))


def _spacing(vertices: ColouredVertices, rows: NDArray[np.intp]) -> Float64s:
    """Return the mean length of the sides at each vertex's place, or of points the distance to the next place."""
    place_of = _places_of(vertices, rows)
    count = int(place_of.max(initial=-1)) + 1
    first = np.zeros(count, np.int64)
    first[place_of] = np.arange(len(rows))
    places = vertices.positions[rows[first]]
    if not len(vertices.faces) and count > 1:
        from scipy.spatial import cKDTree

        apart = np.asarray(cKDTree(places).query(places, k=2)[0], np.float64)
        return np.asarray(apart[place_of, 1])
    number = np.full(len(vertices.positions), -1)
    number[rows] = place_of
    corners = number[vertices.faces]
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = sides[(sides >= 0).all(axis=1) & (sides[:, 0] != sides[:, 1])]
    lengths = np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1)
    total = np.bincount(sides.ravel(), np.repeat(lengths, 2), count)
    ends = np.bincount(sides.ravel(), minlength=count)
    return np.asarray((total / np.maximum(ends, 1))[place_of], np.float64)


def _coded_as_jpeg(layer: Layer, quality: int) -> Float32s:
    """Return the colours of the targets as they are after their pictures went through JPEG."""
    if not isinstance(layer, PictureLayer):
        remedy = "put the colours into a texture first: `beltrami bake --to texture`"
        raise UsageError(f"{layer.label}: JPEG codes pictures; {remedy}")
    if layer.names not in (("red", "green", "blue"), ("grey",)):
        cause = f"{layer.label}: JPEG codes all channels together; leave out --channels and --alpha"
        raise UsageError(cause)
    cells, space = layer.places(), layer.colours.space
    assert isinstance(cells, Cells)
    coded = np.empty((len(cells.row), len(layer.names)), np.float32)
    for index, picture in enumerate(layer.pictures):
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
    new = new_image(np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3))), "a picture")
    new.spec.attribute("jpeg:subsampling", "4:2:0")
    picture = dataclasses.replace(new, format="jpeg", suffix=".jpg")
    return write_image(picture, new.pixels, jpeg_quality=quality).data


def _generator(targets: NoiseTargets, settings: NoiseSettings) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([settings.seed, targets.stream])))


def _drawn(numbers: Float32s) -> Float64s:
    # Multiples of 2^-24; half of that keeps them off 0, where distributions without bound have no inverse.
    return numbers.astype(np.float64) + 2.0**-25


def add_noise(targets: NoiseTargets, settings: NoiseSettings) -> Float32s:
    """Add noise to colours of full scale 1, shape (K, N), clipped to [0, 1] unless some colours lie beyond."""
    colours, number_of = targets.colours, targets.number_of
    if not colours.size or settings.sigma == 0:
        return colours.copy()
    rows, channels = int(number_of.max()) + 1, colours.shape[1]
    columns = 1 if settings.kind == "salt-pepper" else channels
    numbers = _generator(targets, settings).random((rows, columns), dtype=np.float32)
    noisy = np.empty_like(colours)
    for channel in range(channels):
        drawn = numbers[number_of, min(channel, columns - 1)]
        if targets.is_grey is not None:
            drawn = np.where(targets.is_grey, numbers[number_of, 0], drawn)
        noisy[:, channel] = _changed(colours[:, channel].astype(np.float64), _drawn(drawn), settings)
    return noisy.clip(*targets.limits)


def _changed(colours: Float64s, numbers: Float64s, settings: NoiseSettings) -> Float64s:
    from scipy.special import ndtri

    sigma = settings.deviation
    if settings.kind in ("gaussian", "white"):
        return np.asarray(colours + sigma * ndtri(numbers), np.float64)
    if settings.kind == "speckle":
        return np.asarray(colours * (1 + sigma * ndtri(numbers)), np.float64)
    if settings.kind == "poisson":
        from scipy.stats import poisson

        # Photons are counted: full scale is 1 / sigma^2 of them, so that their deviation is sigma of it there.
        counts = poisson.ppf(numbers, np.maximum(colours, 0) / sigma**2)
        return np.where(colours < 0, colours, counts * sigma**2)
    return np.where(numbers < sigma / 2, 0.0, np.where(numbers > 1 - sigma / 2, 1.0, colours))


def seen_by_camera(targets: NoiseTargets, cells: Cells | None, settings: NoiseSettings) -> Float32s:
    """Return colours as a camera sees them: with a mosaic in pictures of three channels, else each by itself."""
    from scipy.special import ndtri

    light = from_space(targets.colours, "linear", targets.space).astype(np.float64)
    count, channels = int(targets.number_of.max()) + 1, light.shape[1]
    numbers = _drawn(_generator(targets, settings).random((count, channels), dtype=np.float32))
    normal = ndtri(numbers)[targets.number_of]
    if targets.is_grey is not None:
        normal[targets.is_grey] = normal[targets.is_grey, :1]
    seen = light + np.sqrt(settings.shot * np.maximum(light, 0) + settings.read**2) * normal
    if cells is not None and channels == 3:
        through = _demosaiced(seen, cells)
        seen = through if targets.is_grey is None else np.where(targets.is_grey[:, None], seen, through)
    most = limits_of(light)[1]
    return to_space(seen.clip(0, most).astype(np.float32), "linear", targets.space)


def _demosaiced(seen: Float64s, cells: Cells) -> Float64s:
    """Return colours as demosaiced from a Bayer mosaic: missing ones are means of neighbours in a chart."""
    result = seen.copy()
    for index, (rows, columns) in enumerate(cells.sizes):
        inside, (row, column) = cells.of(index)
        chart = np.zeros((rows + 2, columns + 2), np.int64)
        chart[row + 1, column + 1] = cells.chart[inside] + 1
        measured = np.zeros(chart.shape)
        samples = np.arange(len(row))
        measured[row + 1, column + 1] = seen[inside][samples, _BAYER[row % 2, column % 2]]
        sums, weights = np.zeros((2, len(row), 3))
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                channel = _BAYER[(row + down) % 2, (column + right) % 2]
                place = row + down + 1, column + right + 1
                weight = np.where(
                    chart[place] == cells.chart[inside] + 1, 0.5 ** (abs(down) + abs(right)), 0.0
                )
                if down and right:
                    weight[channel == 1] = 0.0  # green is measured next to each place
                sums[samples, channel] += weight * measured[place]
                weights[samples, channel] += weight
        result[inside] = np.where(weights > 0, sums / np.where(weights > 0, weights, 1), seen[inside])
    return result


def add_grain(
    targets: NoiseTargets, places: Float64s, spacing: Float64s, settings: NoiseSettings
) -> Float32s:
    """Add noise that neighbours share: of the same deviation everywhere, and a function of the place."""
    colours = targets.colours
    table = _generator(targets, settings).standard_normal((_LATTICE, colours.shape[1]), np.float32)
    table = (table - table.mean(axis=0)) / table.std(axis=0)
    pitch = np.where(spacing > 0, settings.grain_size * spacing, np.inf)
    finite = np.isfinite(pitch)
    base = float(np.median(pitch[finite])) if finite.any() else 1.0
    octave = np.log2(np.where(finite, pitch, base) / base)
    places = (places - places.min(axis=0)) / base
    noisy = np.empty_like(colours)
    for block in large_arrays.blocks(len(colours)):
        low = np.floor(octave[block])
        turn = 0.5 * np.pi * (octave[block] - low)[:, None]
        grain = np.cos(turn) * _on_lattice(places[block], low, table)
        if turn.any():
            grain += np.sin(turn) * _on_lattice(places[block], low + 1, table)
        if targets.is_grey is not None:
            grain[targets.is_grey[block]] = grain[targets.is_grey[block], :1]
        noisy[block] = colours[block] + settings.deviation * grain
    return noisy.clip(*targets.limits)


def _on_lattice(places: Float64s, octave: Float64s, table: Float32s) -> Float64s:
    """Return noise of variance 1 at places, by lattices of the steps 2^octave."""
    scaled = places / np.exp2(octave)[:, None]
    first = np.floor(scaled)
    share, cell = scaled - first, first.astype(np.int64)
    noise, power = np.zeros((len(places), table.shape[1])), np.zeros(len(places))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, share, 1 - share).prod(axis=1)
        if not weight.any():  # images are flat
            continue
        noise += weight[:, None] * table[_hashed(cell + corner, octave)]
        power += weight**2
    return np.asarray(noise / np.sqrt(power)[:, None], np.float64)


def _hashed(cells: Int64s, octave: Float64s) -> Int64s:
    """Return which random number the points of lattices have."""
    mixed = np.zeros(len(cells), np.uint64)
    for part in (*cells.T, octave.astype(np.int64)):
        mixed = (mixed ^ part.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return (mixed % np.uint64(_LATTICE)).astype(np.int64)
