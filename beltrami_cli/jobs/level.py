"""Remove the exposure steps of a file, and change nothing else."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import Any

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.jobs.file_job import FileReport
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.recolour import recolour
from beltrami_cli.jobs.smoothing import Smoothing, unsmoothed
from beltrami_cli.layers.reports import LevelReport
from beltrami_cli.layers.settings import DEFAULTS, LevelSettings, SmoothSettings, describe_settings


@dataclass(frozen=True, kw_only=True)
class LevelFileReport(FileReport):
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    levelled : list of LevelReport
        What was found and done: of each texture slot, or of vertex colours.
    input, output, format, parameters, stages, peak_memory, written, warnings
        As for `SmoothReport`.
    """

    levelled: list[LevelReport]


def level_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    levelling: LevelSettings = LevelSettings(),  # noqa: B008
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    **overrides: Any,
) -> LevelFileReport:
    """Take exposure steps between charts out of the colours of a model, and change nothing else.

    Parameters
    ----------
    source, target : path
        As for `smooth_file`: a model with textures, or with vertex colours that name the photograph of each vertex.
    levelling : LevelSettings
        How strongly, and which charts stay as they are.
    settings : SmoothSettings
        Which colours are meant and how they are written: the working space, channels, slots, textures and their format.
        Gains and offsets are taken in the working space.
    job : Job
        What may be read, a callback for progress, and whether files are written and replaced.
    **overrides
        Single parameters of `levelling` or `settings` by name, such as ``exposure_strength=0.5, slots=("emissive",)``.

    Returns
    -------
    LevelFileReport
        For each slot, whether there were exposure steps, how large, and the exposures of the charts.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, or the colours cannot have exposure steps, as in an image.
    InputError
        If the source cannot be read, has no colours, or does not say which photograph its vertex colours are from.
    OutputError
        If the target cannot be written, or exists and `job.overwrite` is not set. Existing files stay as they were.
    """
    of_levelling = {field.name for field in dataclasses.fields(LevelSettings)} & overrides.keys()
    levelling = override(levelling, **{name: overrides.pop(name) for name in of_levelling})
    settings = override(settings, **overrides)
    if settings.space == "oklab":
        cause = "exposures are gains of channels, which the space oklab mixes"
        raise UsageError(f"{cause}; choose srgb or linear")
    source, target = os.fspath(source), os.fspath(target)
    still = dataclasses.replace(settings, kernel=unsmoothed(settings.kernel))
    described, used = describe_settings(settings), ("threads", "space", "channels", "on", "textures")
    parameters = {name: value for name, value in described.items() if name in used}
    parameters |= dataclasses.asdict(levelling)
    report, results = recolour(source, target, still, Smoothing(still, levelling), job, parameters)
    levelled = [
        dataclasses.replace(each.levelled, change=each.report.change)
        for each in results
        if each.levelled is not None
    ]
    return LevelFileReport(**vars(report), levelled=levelled)
