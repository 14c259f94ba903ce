"""Add noise to the colours of a file: for tests, and to show what smoothing takes away again."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from beltrami_cli.arrays import Float32s
from beltrami_cli.errors import ProcessingError
from beltrami_cli.jobs.file_job import FileReport
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.noise.kinds import add_grain, add_noise, seen_by_camera
from beltrami_cli.jobs.noise.samples import LayerSamples, samples_of
from beltrami_cli.jobs.recolour import ColourFilter, FilterResult, recolour
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.layers.vertex_layer import VertexLayer


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


@dataclass(frozen=True, kw_only=True)
class NoisyResult(FilterResult):
    """Samples with noise, and what it changed."""

    added: Added


@dataclass(frozen=True)
class NoiseFilter(ColourFilter[NoisyResult]):
    """A filter that adds noise."""

    works_in_files: ClassVar[bool] = False
    noise: NoiseSettings

    @property
    def changes(self) -> bool:
        return self.noise.sigma != 0

    def apply(self, layer: Layer, job: Job) -> NoisyResult:
        del job
        samples = samples_of(layer)
        after = _with_noise(samples, self.noise)
        stored = samples.stored(after)
        what = "vertex colours" if isinstance(layer, VertexLayer) else layer.label
        return NoisyResult(stored=stored, added=Added(what, len(after), stored.change.summary()["rms"]))

    def check_results(self, source: str, results: Sequence[NoisyResult]) -> None:
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
    source, target, parameters = os.fspath(source), os.fspath(target), dataclasses.asdict(noise)
    report, results = recolour(source, target, settings, NoiseFilter(noise), job, parameters)
    return NoiseReport(**vars(report), added=[each.added for each in results])


def _with_noise(samples: LayerSamples, settings: NoiseSettings) -> Float32s:
    numbered = samples.numbered
    if not numbered.colours.size or settings.sigma == 0:
        return numbered.colours.copy()
    if settings.kind == "jpeg":
        return samples.coded_as_jpeg(settings.quality)
    if settings.kind == "camera":
        return seen_by_camera(numbered, samples.cells, settings)
    if settings.kind == "grain":
        return add_grain(numbered, *samples.positions(), settings)
    return add_noise(numbered, settings)
