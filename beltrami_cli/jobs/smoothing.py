"""The filter that removes exposure steps and smooths."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import ClassVar

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.chunks import IN_ONE_PIECE
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import should_stay
from beltrami_cli.formats.output_format import OutputFormat
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import Label, PhaseProgress
from beltrami_cli.jobs.recolour import ColourFilter, FilterResult
from beltrami_cli.layers.layer import Layer, Part
from beltrami_cli.layers.reports import LayerReport, LevelReport
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings

_USUAL_STEPS = 30  # of choosing parameters, for progress alone


@dataclass(frozen=True, kw_only=True)
class Smoothed(FilterResult):
    """A smoothed layer."""

    part: Part  # of the document
    report: LayerReport
    choice: Choice | None
    samples_per_kernel: float  # not rounded, as in the report
    levelled: LevelReport | None = None  # what was done to exposure steps before


def smooth_layer(
    layer: Layer,
    progress: PhaseProgress | None = None,
    tick: Callable[[], None] | None = None,
) -> Smoothed:
    """Choose parameters, calling `tick`, run the flow on a layer, and put the colours back.

    If all was chosen from the data, and the kernel is estimated to make the colours worse, they stay.
    """
    layer = layer.normalised()
    plan = layer.plan(tick)
    result = smooth_in_place(plan, progress)
    report, new = layer.report(plan, result), result.manifold.new_colours()
    warnings = report.warnings(plan.parameters.max_samples)
    is_smoothed = plan.parameters.iterations > 0 or bool(plan.outliers.get("replaced"))
    if should_stay(plan.choice, layer.kernel):
        warnings.append(f"{layer.label}: smoothing was estimated to make the colours worse, so they stay.")
    choice = None if result.choice is None else result.choice.in_unit(layer.unit)
    samples_per_kernel = result.samples_per_kernel
    del plan, result  # before images as large are made
    stored = layer.encode(new, is_smoothed=is_smoothed)
    return Smoothed(
        part=layer.part, stored=stored,
        report=dataclasses.replace(report, change=stored.change.summary()), warnings=warnings,
        choice=choice, samples_per_kernel=samples_per_kernel, levelled=layer.level_report,
    )  # fmt: skip


def unsmoothed(kernel: KernelParameters) -> KernelParameters:
    return dataclasses.replace(kernel, iterations=0, free=(), patches="off")


def smooth_in_job(layer: Layer, job: Job, label: str) -> Smoothed:
    """Smooth a layer, whose name in progress is `label`."""
    choosing, steps = job.progress_of(Label(f"{label}: choosing parameters", "choosing parameters")), count()

    def tick() -> None:
        # The number of steps is unknown: progress shows n / (n + 30) after n of them.
        if choosing is not None:
            choosing(number := next(steps), number + _USUAL_STEPS)

    tick()
    smoothing = job.progress_of(Label(f"{label}: smoothing", "smoothing"))
    return smooth_layer(layer, smoothing, tick)


@dataclass(frozen=True)
class Smoothing(ColourFilter[Smoothed]):
    """A filter that removes exposure steps, if that is wanted, and then smooths."""

    colours_only: ClassVar[bool] = False

    settings: SmoothSettings
    levelling: LevelSettings | None = None

    @classmethod
    def of(cls, settings: SmoothSettings) -> Smoothing:
        return cls(settings, LevelSettings() if settings.level_seams else None)

    @property
    def _has_iterations(self) -> bool:
        return self.settings.kernel.iterations != 0

    @property
    def phases(self) -> Sequence[str]:
        return ("choosing parameters", "smoothing") if self._has_iterations else ("recolouring",)

    @property
    def changes(self) -> bool:
        encodes = self.settings.textures.image_suffix is not None
        return self._has_iterations or self.levelling is not None or encodes

    @property
    def works_in_groups(self) -> bool:
        return self.levelling is None and self.settings.fits_parts

    def check(self, selection: Selection, target: OutputFormat) -> Sequence[str]:
        if self.changes:
            selection.require_geometry(is_patched=target.is_patched)
        notices = selection.require_scale()
        if self.levelling is not None and selection.image:
            cause = "an image has no charts that could differ in exposure; give a model with textures"
            raise UsageError(cause, selection.document.name)
        return notices

    def apply(self, layer: Layer, job: Job) -> Smoothed:
        if self.levelling is not None:
            layer = layer.levelled(self.levelling)
        if self._has_iterations:
            return smooth_in_job(layer, job, layer.label)
        # Only iterations are done in chunks.
        return smooth_layer(dataclasses.replace(layer, resources=IN_ONE_PIECE))
