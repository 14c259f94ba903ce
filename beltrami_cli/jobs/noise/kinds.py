"""The kinds of noise, as functions of colours.

Samples at one place share a random number, so that split vertices stay equal and seams stay invisible. Independent
noise is a function of the colour and of a uniform random number: the inverse of a distribution function. Samples with
equal colours and numbers change equally, and samples at one place with different colours change in the same direction.
A camera counts photons in linear light, with a variance of A L + B^2; images of three channels are seen through a Bayer
mosaic, which is demosaiced bilinearly, chart by chart. Grain is a function of the place in space: random numbers on a
lattice, interpolated linearly and divided by the deviation of the interpolated number.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.parameters import Space
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import from_space, limits_of, to_space
from beltrami_cli.surface.records import Cells

_BAYER = np.array([[0, 1], [1, 2]])  # the channel that is measured, by row and column
_LATTICE = 1 << 16  # random numbers, which points of a lattice share by a hash


@dataclass(frozen=True)
class NumberedSamples:
    """Colours in the working space, and the random numbers that they are changed by."""

    colours: Float32s  # shape (K, N)
    number_of: NDArray[np.integer[Any]]  # random number of each, shape (K,); the same for all at one place
    stream: int = 0  # separates the random numbers of parts of a document
    is_grey: Bools | None = None  # where all channels are one, shape (K,); None: nowhere
    space: Space = "srgb"

    @property
    def limits(self) -> tuple[float, float]:
        """Values at which colours with noise are clipped."""
        return limits_of(self.colours)


def as_jpeg(shown: Float32s, quality: int) -> Float32s:
    """Return display values of an image, (H, W, 1 or 3), as they are after JPEG with colour at half the resolution."""
    coded = read_image(jpeg_file(shown, quality), "an image").pixels
    return np.asarray(coded[..., : shown.shape[2]] / np.float32(255), np.float32)


def jpeg_file(shown: Float32s, quality: int) -> bytes:
    """Return the JPEG file of display values, (H, W, 1 or 3), with colour at half the resolution."""
    pixels = np.rint(255 * np.clip(shown, 0, 1)).astype(np.uint8)
    new = new_image(np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3))), "an image")
    new.spec.attribute("jpeg:subsampling", "4:2:0")
    image = dataclasses.replace(new, format="jpeg", suffix=".jpg")
    return write_image(image, new.pixels, jpeg_quality=quality).data


def _generator(samples: NumberedSamples, settings: NoiseSettings) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([settings.seed, samples.stream])))


def _above_zero(numbers: Float32s) -> Float64s:
    # Multiples of 2^-24; half of that keeps them off 0, where distributions without bound have no inverse.
    return numbers.astype(np.float64) + 2.0**-25


def add_noise(samples: NumberedSamples, settings: NoiseSettings) -> Float32s:
    """Add noise to colours of full scale 1, shape (K, N), clipped to [0, 1] unless some colours lie beyond."""
    colours, number_of = samples.colours, samples.number_of
    rows, channels = int(number_of.max()) + 1, colours.shape[1]
    columns = 1 if settings.kind == "salt-pepper" else channels
    numbers = _generator(samples, settings).random((rows, columns), dtype=np.float32)
    noisy = np.empty_like(colours)
    for channel in range(channels):
        drawn = numbers[number_of, min(channel, columns - 1)]
        if samples.is_grey is not None:
            drawn = np.where(samples.is_grey, numbers[number_of, 0], drawn)
        noisy[:, channel] = _independent_noise(
            colours[:, channel].astype(np.float64), _above_zero(drawn), settings
        )
    return noisy.clip(*samples.limits)


def _independent_noise(colours: Float64s, numbers: Float64s, settings: NoiseSettings) -> Float64s:
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


def seen_by_camera(samples: NumberedSamples, cells: Cells | None, settings: NoiseSettings) -> Float32s:
    """Return colours as a camera sees them: with a mosaic in images of three channels, else each by itself."""
    from scipy.special import ndtri

    light = from_space(samples.colours, "linear", samples.space).astype(np.float64)
    count, channels = int(samples.number_of.max()) + 1, light.shape[1]
    numbers = _above_zero(_generator(samples, settings).random((count, channels), dtype=np.float32))
    normal = ndtri(numbers)[samples.number_of]
    if samples.is_grey is not None:
        normal[samples.is_grey] = normal[samples.is_grey, :1]
    seen = light + np.sqrt(settings.shot * np.maximum(light, 0) + settings.read**2) * normal
    if cells is not None and channels == 3:
        through = _demosaiced(seen, cells)
        seen = through if samples.is_grey is None else np.where(samples.is_grey[:, None], seen, through)
    most = limits_of(light)[1]
    return to_space(seen.clip(0, most).astype(np.float32), "linear", samples.space)


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
    samples: NumberedSamples, places: Float64s, spacing: Float64s, settings: NoiseSettings
) -> Float32s:
    """Add noise that neighbours share: of the same deviation everywhere, and a function of the place."""
    colours = samples.colours
    table = _generator(samples, settings).standard_normal((_LATTICE, colours.shape[1]), np.float32)
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
        if samples.is_grey is not None:
            grain[samples.is_grey[block]] = grain[samples.is_grey[block], :1]
        noisy[block] = colours[block] + settings.deviation * grain
    return noisy.clip(*samples.limits)


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
