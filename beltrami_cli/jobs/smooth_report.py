"""The report of a smoothed file."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beltrami_cli.jobs.file_job import FileReport
from beltrami_cli.jobs.smoothing import Smoothed
from beltrami_cli.layers.layer import Part
from beltrami_cli.layers.reports import ImageReport, LayerReport, LevelReport, SlotReport, VertexReport
from beltrami_cli.layers.storing import Change


@dataclass(frozen=True, kw_only=True)
class SmoothReport(FileReport):
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Paths of the input and output, and the format written.
    parameters : dict
        The parameters that were requested. Those named in "given" are not as by default; those named in "free" were
        chosen from the data, and the chosen values are in the records below.
    vertices : VertexReport or None
        Statistics of vertex colours, if they were smoothed.
    textures : list of SlotReport
        Statistics of each texture slot that was smoothed.
    stages : dict
        "wall" and "cpu" seconds per stage.
    peak_memory : int or None
        Peak resident size of the process in bytes.
    written : list of str
        The files that were written; none on a dry run.
    warnings : list of str
        Messages for the user.
    image : ImageReport or None
        Statistics of an image, if it was smoothed.
    levelled : list of LevelReport
        What was done to exposure steps before, if that was asked for.
    new_texture : str
        What kind of texture was made, in words; empty if none was.
    """

    vertices: VertexReport | None
    textures: list[SlotReport]
    image: ImageReport | None = None
    levelled: list[LevelReport] = field(default_factory=list)
    new_texture: str = ""


def smooth_report(report: FileReport, results: Sequence[Smoothed]) -> SmoothReport:
    """Add the changes of layers to the report of a file."""
    groups: dict[object, list[Smoothed]] = {}
    for number, result in enumerate(results):
        groups.setdefault(_group_key(result.report) or number, []).append(result)
    parts: dict[Part, list[Any]] = {"vertices": [], "textures": [], "image": []}
    for group in groups.values():
        parts[group[0].part].append(_joined(group))
    return SmoothReport(
        **vars(report),
        vertices=next(iter(parts["vertices"]), None),
        textures=parts["textures"],
        image=next(iter(parts["image"]), None),
        levelled=[each.levelled for each in results if each.levelled is not None],
    )


def _group_key(report: LayerReport) -> object:
    """Return what layers of one slot have in common that are reported together; None: the layer stays alone."""
    if not isinstance(report, SlotReport):
        return None
    return report.slot, str(report.choice), str(report.noise), str(report.wrong_samples)


def _joined(group: Sequence[Smoothed]) -> LayerReport:
    """Return one report for groups of textures of one slot that have the same noise and parameters."""
    reports = [each.report for each in group if isinstance(each.report, SlotReport)]
    if len(reports) < 2:
        return group[0].report
    texels = [max(1, report.counts["covered"]) for report in reports]

    def mean(name: str) -> float:
        return float(np.average([getattr(report, name) or 0.0 for report in reports], weights=texels))

    return dataclasses.replace(
        reports[0],
        textures=[texture for report in reports for texture in report.textures],
        counts={key: sum(report.counts[key] for report in reports) for key in reports[0].counts},
        pitch=mean("pitch"),
        samples_per_kernel=round(mean("samples_per_kernel"), 2),
        patches=None if reports[0].patches is None else mean("patches"),
        change=Change.joined(each.stored.change for each in group).summary(),
    )
