"""Compare the colours of two documents: their common parts, and the differences of these."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.compare.figures import Figures, figures
from beltrami_cli.jobs.compare.measured import ComparedPart, Measured, measure
from beltrami_cli.jobs.compare.pixel_parts import compare_images, compare_textures
from beltrami_cli.jobs.compare.same_model import Documents, Moves, moves_between
from beltrami_cli.jobs.compare.selection import choose_parts
from beltrami_cli.jobs.compare.vertex_parts import compare_vertices
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.opening import open_any, require_level_set
from beltrami_cli.jobs.progress import phases_of, tracked
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.surface.records import Slot

ALL_SLOTS = dataclasses.replace(DEFAULTS, textures=dataclasses.replace(DEFAULTS.textures, slots=()))
"""Settings of a comparison of all that is coloured: where no slots are named, all are compared."""


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

    def overall(self) -> Figures:
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
    comparisons = list[Callable[[], list[ComparedPart]]]()
    if selection.image:
        comparisons.append(partial(compare_images, documents, settings, job.access))
    if selection.vertices:
        is_extra = bool(selection.slots)
        comparisons.append(partial(compare_vertices, documents, settings, weights, is_extra=is_extra))
    for slot in selection.slots:
        is_extra = slot != selection.slots[0]
        comparisons.append(
            partial(compare_textures, documents, slot, settings, weights, job.access, is_extra=is_extra)
        )
    parts = [part for compare in tracked(comparisons, "comparing", job.progress) for part in compare()]
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


def open_both(names: tuple[str, str], settings: SmoothSettings, job: Job) -> tuple[Document, Document]:
    """Open both; one may be a level set, and the other the mesh that was made of it."""
    one, other = (open_any(name, settings, job.access) for name in tracked(names, "reading", job.progress))
    require_level_set(settings, one, other)
    return one, other
