"""Take exposure steps between the charts of a file out of its colours."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.jobs.job import PLAIN_JOB, peak_memory
from beltrami_cli.jobs.recolour import recolour
from beltrami_cli.samples.levelled_charts import photographs_of
from beltrami_cli.samples.reports import describe_settings
from beltrami_cli.samples.settings import DEFAULTS, LevelSettings

if TYPE_CHECKING:
    from beltrami_cli.arrays import Int64s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.samples.reports import LevelReport
    from beltrami_cli.samples.samples import Repainted, Samples
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import SmoothSettings


@dataclass(frozen=True)
class LevelFileReport:
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Paths of the input and output, and the format written.
    parameters : dict
        The parameters that were requested.
    levelled : list of LevelReport
        What was found and done: of each texture slot, or of vertex colours.
    stages, peak_memory, written, warnings
        As for `SmoothReport`.
    """

    input: str
    output: str
    format: str
    parameters: dict[str, object]
    levelled: list[LevelReport]
    stages: dict[str, dict[str, float]]
    peak_memory: int | None
    written: list[str]
    warnings: list[str]


def level_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    wanted: LevelSettings = LevelSettings(),  # noqa: B008
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    **overrides: Any,
) -> LevelFileReport:
    """Take exposure steps between charts out of the colours of a model, and change nothing else.

    Parameters
    ----------
    source, target : path
        As for `smooth_file`: a model with textures, or with vertex colours that name the photograph of each vertex.
    wanted : LevelSettings
        How strongly, and which charts stay as they are.
    settings : SmoothSettings
        Which colours are meant and how they are written: the working space, channels, slots, textures and their format.
        Gains and offsets are taken in the working space.
    job : Job
        What may be read, a callback for progress, and whether files are written and replaced.
    **overrides
        Single parameters of `wanted` or `settings` by name, such as ``strength=0.5, slots=("emissive",)``.

    Returns
    -------
    LevelFileReport
        For each slot, whether there were exposure steps, how large, and the exposures of the charts.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, or the colours cannot have exposure steps, as those of an image.
    InputError
        If the source cannot be read, has no colours, or does not say which photograph its vertex colours are from.
    OutputError
        If the target cannot be written, or exists and `job.overwrite` is not set. Existing files stay as they were.
    """
    own = {field.name for field in dataclasses.fields(LevelSettings)}
    wanted = override(wanted, **{name: value for name, value in overrides.items() if name in own})
    settings = override(settings, **{name: value for name, value in overrides.items() if name not in own})
    if settings.space == "oklab":
        raise UsageError(
            "exposures are gains of channels, which the space oklab mixes; choose srgb or linear"
        )
    source, target = os.fspath(source), os.fspath(target)
    painter = Levelling(wanted)
    made = recolour(source, target, settings, painter, job)
    return LevelFileReport(
        source,
        target,
        made.format,
        {**_described(settings), **dataclasses.asdict(wanted)},
        painter.done,
        made.stages,
        peak_memory(),
        made.written,
        list(dict.fromkeys(made.warnings)),
    )


def _described(settings: SmoothSettings) -> dict[str, object]:
    """Return which colours were meant, and how they were written."""
    used = ("threads", "space", "channels", "on", "textures")
    return {name: value for name, value in describe_settings(settings).items() if name in used}


class Levelling:
    """A painter that takes exposure steps out."""

    changes = True
    colours_only = True
    works_on_disk = True
    works_in_groups = False  # exposures are fitted to all seams together

    def __init__(self, wanted: LevelSettings) -> None:
        self._wanted = wanted
        self._photographs: Int64s | None = None
        self.done: list[LevelReport] = []

    def check(self, document: Document, selection: Selection, target: OutputFormat) -> None:
        """Raise InputError if vertex colours do not say which photograph they are from."""
        del target
        if selection.vertices:
            self._photographs = photographs_of(document, self._wanted.photographs)

    def level(self, samples: Samples) -> LevelReport:
        """Level samples, before they are painted otherwise."""
        return samples.level(self._wanted, self._photographs if samples.part == "vertices" else None)

    def paint(self, samples: Samples, job: Job) -> Repainted:
        """Level samples, and do nothing else to them."""
        del job
        report = self.level(samples)
        repainted = samples.repaint(samples.levelled())
        self.done.append(dataclasses.replace(report, change=repainted.change.summary()))
        return repainted
