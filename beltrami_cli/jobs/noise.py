"""Add noise to the colours of a file: for tests, and to show what smoothing takes away again.

Noise of each kind is a function of a colour and of a uniform random number of the sample: the inverse of a distribution
function. So samples with one colour and one number change alike, and samples at one place with different colours change
in the same direction.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.jobs.job import PLAIN_JOB
from beltrami_cli.jobs.recolour import recolour
from beltrami_cli.samples.settings import DEFAULTS

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.jobs.settings import NoiseSettings
    from beltrami_cli.samples.samples import Grains, Repainted, Samples
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import SmoothSettings


@dataclass(frozen=True)
class Added:
    """What noise changed: which colours, how many samples, and the root mean square change, of full scale 1."""

    what: str
    samples: int
    rms: float


@dataclass(frozen=True)
class NoiseReport:
    """What was done: to which colours, the files that were written, and what the user should know."""

    added: list[Added]
    files: list[str]
    warnings: list[str]


class Noising:
    """A painter that adds noise."""

    colours_only = True
    works_on_disk = works_in_groups = False

    def __init__(self, noise: NoiseSettings) -> None:
        self._noise = noise
        self.changes = noise.sigma != 0
        self.added: list[Added] = []

    def check(self, document: Document, selection: Selection, target: OutputFormat) -> None:
        """Accept all."""

    def paint(self, samples: Samples, job: Job) -> Repainted:
        del job
        grains = samples.grains()
        after = add_noise(grains, self._noise)
        change = np.square(after - grains.colours, dtype=np.float64)
        what = "vertex colours" if samples.part == "vertices" else samples.label
        self.added.append(Added(what, len(change), float(np.sqrt(np.mean(change))) if change.size else 0.0))
        return samples.shift(grains, after)


def noise_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    noise: NoiseSettings,
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
) -> NoiseReport:
    """Add noise to the selected colours of a model, points, a level set or an image, and change nothing else."""
    painter = Noising(noise)
    made = recolour(os.fspath(source), os.fspath(target), settings, painter, job)
    return NoiseReport(painter.added, made.written, made.warnings)


def add_noise(grains: Grains, settings: NoiseSettings) -> Float32s:
    """Add noise to colours of full scale 1, shape (K, N), clipped to [0, 1] unless some colours lie beyond."""
    colours, number_of = grains.colours, grains.number_of
    if not colours.size or settings.sigma == 0:
        return colours.copy()
    rows, channels = int(number_of.max()) + 1, colours.shape[1]
    columns = 1 if settings.kind == "salt-pepper" else channels
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence([settings.seed, grains.stream])))
    numbers = generator.random((rows, columns), dtype=np.float32)
    noisy = np.empty_like(colours)
    for channel in range(channels):
        drawn = numbers[number_of, min(channel, columns - 1)]
        if grains.grey is not None:
            drawn = np.where(grains.grey, numbers[number_of, 0], drawn)
        # Multiples of 2^-24; half of that keeps them off 0, where distributions without bound have no inverse.
        drawn = drawn.astype(np.float64) + 2.0**-25
        noisy[:, channel] = _changed(colours[:, channel].astype(np.float64), drawn, settings)
    return noisy.clip(*grains.limits)


def _changed(colours: Float64s, numbers: Float64s, settings: NoiseSettings) -> Float64s:
    from scipy.special import ndtri

    sigma = settings.sigma
    if settings.kind == "gaussian":
        return np.asarray(colours + sigma * ndtri(numbers), np.float64)
    if settings.kind == "speckle":
        return np.asarray(colours * (1 + sigma * ndtri(numbers)), np.float64)
    if settings.kind == "poisson":
        return _counted(colours, numbers, sigma)
    return np.where(numbers < sigma / 2, 0.0, np.where(numbers > 1 - sigma / 2, 1.0, colours))


def _counted(colours: Float64s, numbers: Float64s, sigma: float) -> Float64s:
    """Count photons: full scale is 1 / sigma^2 of them, so that their deviation is sigma of full scale there."""
    from scipy.stats import poisson

    counts = poisson.ppf(numbers, np.maximum(colours, 0) / sigma**2)
    return np.where(colours < 0, colours, counts * sigma**2)
