"""Compare the colours of two files, check the difference against limits, and draw it."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.compare.figures import ComparedPart, Measured, figures, measure
from beltrami_cli.jobs.compare.limits import Verdict, check_limits, check_moves
from beltrami_cli.jobs.compare.maps import draw_map, open_map
from beltrami_cli.jobs.compare.parts import compare_images, compare_textures, compare_vertices
from beltrami_cli.jobs.compare.same_model import Documents, Moves, moves_between
from beltrami_cli.jobs.compare.selection import choose_parts
from beltrami_cli.jobs.file_job import open_any, require_level_set
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.progress import phases_of, tracked
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.jobs.writing.output import Overwrite
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.surface.records import Slot

ALL_SLOTS = dataclasses.replace(DEFAULTS, textures=dataclasses.replace(DEFAULTS.textures, slots=()))
"""Settings of a comparison of all that is coloured: where no slots are named, all are compared."""

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
    parts: list[dict[str, Any]]
    overall: dict[str, Any]
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
    described = [measured.described() for measured in compared.measured]
    verdicts, untested = check_limits(described, limits, documents[1].name)
    moves = compared.moves
    verdicts += [] if moves is None else check_moves(moves, limits)
    scale = None
    if output is not None:
        written, scale = draw_map(compared.measured, documents[0], output.target)
        output.write(written)
    return Comparison(
        reference=names[0], test=names[1], weights=weights, space=settings.space, parts=described,
        overall=compared.overall(), geometry=moves, limits=verdicts, passed=all(each.kept for each in verdicts),
        map_scale=scale, notices=[*compared.notices(), *untested],
    )  # fmt: skip


def require_samples(parts: Sequence[ComparedPart], name: str) -> None:
    """Raise InputError if nothing can be compared, or parts weighted by area have none."""
    if not sum(len(part.index) for part in parts):
        raise InputError(
            name,
            "nothing of it can be compared: no texel that the surface covers, or no pixel, can be seen",
            "choose something else with --on, --slots or --mask",
        )
    for part in parts:
        if len(part.index) and part.weights is not None and not part.weights.sum() > 0:
            cause = f"{part.name}: the surface has no area that samples could stand for"
            raise InputError(name, cause, "use --weights uniform")


@dataclass(frozen=True)
class ComparedDocuments:
    """The common parts of two documents, and their differences."""

    measured: list[Measured]  # the vertices first
    moves: Moves | None = None  # of the vertices of a model
    slots: tuple[Slot, ...] = ()  # whose textures are among the parts
    selection_notices: tuple[str, ...] = ()

    @property
    def parts(self) -> list[ComparedPart]:
        return [measured.part for measured in self.measured]

    def differing(self) -> list[Measured]:
        """Return the parts that have figures."""
        return [measured for measured in self.measured if not measured.part.is_identical]

    def overall(self) -> dict[str, Any]:
        return figures(self.differing())

    def notices(self) -> list[str]:
        """Return notices for users, above all on colours that are not compared."""
        found = [*self.selection_notices]
        if self.moves is not None and not self.moves.is_rounding:
            largest, mean = (f"{100 * move:.3g} %" for move in (self.moves.largest, self.moves.mean))
            found.append(
                "its vertices are at other places than in the reference: "
                f"they moved by up to {largest} of the model's size, {mean} on average"
            )
        for part in self.parts:
            if not len(part.index) and not part.is_identical:
                cause = "no texel of it is both covered by the surface and visible"
                found.append(f"{part.name} is not compared, because {cause}")
            if part.other_opacity:
                found.append(f"{part.name}: opacity differs, and is not compared")
        return found


def compare_documents(
    documents: Documents,
    settings: SmoothSettings,
    weights: Weights,
    job: Job = PLAIN_JOB,
    further: Sequence[str] = (),
) -> ComparedDocuments:
    """Compare the colours of two models, or of two images; `further` phases of progress follow."""
    selection, notices = choose_parts(documents, settings)
    samples = sum(selection.work())
    job.expect(phases_of(["comparing", "measuring", *further], samples))
    for document in documents:
        dataclasses.replace(selection, document=document).require_memory()
    parts = list[ComparedPart]()
    without_slot = [None] * (selection.image or selection.vertices)
    for slot in tracked([*without_slot, *selection.slots], "comparing", job.progress):
        if slot is not None:
            is_extra = slot != selection.slots[0]
            parts += compare_textures(documents, slot, settings, weights, job.access, is_extra=is_extra)
        elif selection.image:
            parts.append(compare_images(documents, settings, job.access))
        else:
            is_extra = bool(selection.slots)
            parts.append(compare_vertices(documents, settings, weights, is_extra=is_extra))
    moves = None if selection.image else moves_between(documents, selection)
    return ComparedDocuments(_measure_all(parts, job), moves, selection.slots, tuple(notices))


def _measure_all(parts: Sequence[ComparedPart], job: Job) -> list[Measured]:
    total, done, measured = sum(len(part.index) for part in parts), 0, []
    progress = job.progress_of("measuring")

    def tick(share: float) -> None:
        if progress is not None:
            progress(done + round(share * len(part.index)), total)

    for part in parts:
        measured.append(measure(part, tick))
        done += len(part.index)
    return measured


def open_both(names: tuple[str, str], settings: SmoothSettings, job: Job) -> tuple[Document, Document]:
    """Open both; one may be a level set, and the other the mesh that was made of it."""
    one, other = (open_any(name, settings, job.access) for name in tracked(names, "reading", job.progress))
    require_level_set(settings, one, other)
    return one, other
