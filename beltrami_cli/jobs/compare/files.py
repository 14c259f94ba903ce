"""Compare the colours of two files, check the difference against limits, and draw it."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.jobs.compare.documents import ALL_SLOTS, compare_documents, open_both, require_samples
from beltrami_cli.jobs.compare.figures import Figures, PartFigures, figures_of
from beltrami_cli.jobs.compare.limits import Verdict, check_limits, check_moves
from beltrami_cli.jobs.compare.maps import draw_map, open_map
from beltrami_cli.jobs.compare.same_model import Moves
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.jobs.writing.output import Overwrite
from beltrami_cli.layers.settings import SmoothSettings

_NO_LIMITS = Limits()


@dataclass(frozen=True)
class Comparison:
    """How two files differ; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    reference, test, weights, space : str
        Paths of the files, what a sample counts, and what colours were taken as.
    parts, overall : list of dict, dict
        "name", "kind" and figures of each texture, the image, or the vertices, with "identical": equal, among several
        parts; and the figures of all together that are not identical.
    geometry : Moves or None
        How far vertices moved; None for images.
    limits, passed : list of Verdict, bool
        For each limit and part what was "measured" and "allowed", and whether it is "kept"; whether all are.
    map_scale, notices : float or None, list of str
        The Delta E that the brightest colour of the map stands for, and messages for the user.
    """

    reference: str
    test: str
    weights: str
    space: str
    parts: list[PartFigures]
    overall: Figures
    geometry: Moves | None
    limits: list[Verdict]
    passed: bool
    map_scale: float | None
    notices: list[str]


def compare_files(
    reference: str | os.PathLike[str],
    test: str | os.PathLike[str],
    limits: Limits = _NO_LIMITS,
    settings: SmoothSettings = ALL_SLOTS,
    *,
    weights: Weights = "uniform",
    map_to: str | os.PathLike[str] | None = None,
    overwrite: Overwrite = False,
    job: Job = PLAIN_JOB,
) -> Comparison:
    """Compare the colours of two files of one model, or of two images; by default all that is coloured."""
    names = os.fspath(reference), os.fspath(test)
    if names == ("-", "-"):
        raise UsageError("only one of REFERENCE and TEST can be standard input")
    output = None
    if map_to is not None:
        output = open_map(os.fspath(map_to), names, settings, overwrite)
        job = dataclasses.replace(job, access=output.files.watching(job.access))
    documents = open_both(names, settings, job)
    compared = compare_documents(documents, settings, weights, job)
    require_samples(compared.parts, documents[0].name)
    parts = [figures_of(measured) for measured in compared.measured]
    verdicts, untested = check_limits(parts, limits, documents[1].name)
    moves = compared.moves
    verdicts += [] if moves is None else check_moves(moves, limits)
    scale = None
    if output is not None:
        written, scale = draw_map(compared.measured, documents[0], output.target)
        output.write(written)
    return Comparison(
        reference=names[0], test=names[1], weights=weights, space=settings.space, parts=parts,
        overall=compared.overall(), geometry=moves, limits=verdicts, passed=all(each.kept for each in verdicts),
        map_scale=scale, notices=[*compared.notices(), *untested],
    )  # fmt: skip
