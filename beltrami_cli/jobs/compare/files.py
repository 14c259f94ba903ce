"""Compare the colours of two files, and hold the difference to limits."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.image import ImageDocument
from beltrami_cli.formats.registry import kind_of
from beltrami_cli.jobs.compare.figures import Verdict, check_limits, check_moves, figures
from beltrami_cli.jobs.compare.map import draw_map, is_map, require_map
from beltrami_cli.jobs.compare.models import EVERYTHING, Moves, choose_parts, moves_between
from beltrami_cli.jobs.compare.parts import compare_images, compare_textures, compare_vertices
from beltrami_cli.jobs.documents import document_from
from beltrami_cli.jobs.job import PLAIN_JOB, Job, tracked
from beltrami_cli.jobs.output import Output, Overwrite
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.samples.memory_check import require_memory_for_textures
from beltrami_cli.samples.settings import DEFAULTS, LevelSetSettings

if TYPE_CHECKING:
    from beltrami_cli.flow.parameters import Weights
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.compare.figures import ComparedColours
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import Slot

_UNLIMITED = Limits()


@dataclass(frozen=True)
class Comparison:
    """How two files differ; `dataclasses.asdict` gives JSON types."""

    reference: str
    test: str
    weights: str  # what a sample counts
    space: str  # what colours were taken as
    # "name", "kind" and figures of each texture, the image, or the vertices; "identical" is what is equal beside others
    parts: list[dict[str, Any]]
    overall: dict[str, Any]  # those of all parts together that are not identical
    geometry: dict[str, float] | None  # how far vertices moved, in longest sides of the model; None: an image
    limits: list[Verdict]
    passed: bool  # whether each part keeps to each limit
    map_scale: float | None  # the Delta E that the brightest colour of the map stands for
    notices: list[str]

    @property
    def has_moved(self) -> bool:
        """Whether vertices moved by more than rounding explains."""
        return self.geometry is not None and not Moves(*self.geometry.values()).is_rounding


def compare_files(
    reference: str | os.PathLike[str],
    test: str | os.PathLike[str],
    limits: Limits = _UNLIMITED,
    settings: SmoothSettings = EVERYTHING,
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
        output = _opened_map(os.fspath(map_to), names, settings, overwrite)
        job = dataclasses.replace(job, access=output.files.watching(job.access))
    data = read_source(names[0], job.access), read_source(names[1], job.access)
    documents = open_both(names, data, settings, job)
    compared = compare_documents(documents, settings, weights, job)
    require_samples(compared.parts, documents[0].name)
    described = [part.described() for part in tracked(compared.parts, "measuring", job.progress)]
    verdicts, untested = check_limits(described, limits, documents[1].name)
    moves = compared.moves
    verdicts += [] if moves is None else check_moves(moves, limits)
    scale = None
    if output is not None:
        written, scale = draw_map(compared.parts, documents[0], output.target)
        output.write(written)
    geometry = None if moves is None else dataclasses.asdict(moves)
    passed = all(verdict.kept for verdict in verdicts)
    notices = [*compared.all_notices(), *untested]
    return Comparison(
        *names, weights, settings.space, described, figures(compared.measured()), geometry, verdicts, passed,
        scale, notices,
    )  # fmt: skip


def _opened_map(
    target: str, names: tuple[str, str], settings: SmoothSettings, overwrite: Overwrite
) -> Output:
    """Check that a map can be written before anything is compared."""
    require_map(target)
    output = Output(target, overwrite=overwrite, what="map", is_own=is_map, reads=names)
    output.files.guard(settings.files_besides())
    return output


def require_samples(parts: list[ComparedColours], name: str) -> None:
    """Raise InputError if nothing can be compared, or what counts by its area has none."""
    if not sum(len(part.reference) for part in parts):
        raise InputError(
            name,
            "nothing of it can be compared: no texel that the surface covers, or no pixel, can be seen",
            "choose something else with --on, --slots or --mask",
        )
    for part in parts:
        if len(part.weights) and not part.weights.sum() > 0:
            cause = f"{part.name}: the surface has no area that samples could stand for"
            raise InputError(name, cause, "use --weights uniform")


@dataclass(frozen=True)
class Compared:
    """What two documents have in common, and how far it differs."""

    parts: list[ComparedColours]  # the vertices first
    moves: Moves | None = None  # of the vertices of a model
    slots: tuple[Slot, ...] = ()  # whose textures are among the parts
    notices: tuple[str, ...] = ()

    def measured(self) -> list[ComparedColours]:
        """Return the parts that figures are of."""
        return [part for part in self.parts if not part.is_identical]

    def all_notices(self) -> list[str]:
        """Return what users should know, above all what is not compared."""
        found = [*self.notices]
        if self.moves is not None and not self.moves.is_rounding:
            found.append(
                f"its vertices are not where those of the reference are: {move_in_words(self.moves)}"
            )
        for part in self.parts:
            if not len(part.reference) and not part.is_identical:
                cause = "no texel of it is both covered by the surface and visible"
                found.append(f"{part.name} is not compared, because {cause}")
            if part.other_opacity:
                found.append(f"{part.name}: opacity differs, and is not compared")
        return found


def move_in_words(moves: Moves) -> str:
    """Say how far vertices moved."""
    largest, mean = (f"{100 * move:.3g} %" for move in (moves.largest, moves.mean))
    return f"they moved by up to {largest} of the model's size, {mean} on average"


def compare_documents(
    documents: tuple[Document, Document], settings: SmoothSettings, weights: Weights, job: Job = PLAIN_JOB
) -> Compared:
    """Bring the colours of two models, or of two images, together."""
    images = [document for document in documents if isinstance(document, ImageDocument)]
    if len(images) == 1:
        kinds = ["an image" if document in images else "a model" for document in documents]
        raise InputError(
            documents[1].name,
            f"it is {kinds[1]}, but {documents[0].name} is {kinds[0]}",
            "compare two files of one kind",
        )
    if images:
        return Compared([compare_images(images, _of_images(settings), job.access)])
    selection, notices = choose_parts(documents, settings)
    reference, test = documents
    parts = []
    # None: the vertices.
    chosen = [*([None] if selection.vertices else []), *selection.slots]
    for slot in tracked(chosen, "comparing", job.progress):
        if slot is None:
            is_extra = bool(selection.slots)
            parts.append(compare_vertices(reference, test, settings, weights, is_extra=is_extra))
            continue
        for document in documents:
            require_memory_for_textures(document, selection.slots, settings.textures, job.access)
        is_extra = slot != selection.slots[0]
        parts += compare_textures(reference, test, slot, settings, weights, job.access, is_extra=is_extra)
    return Compared(parts, moves_between(documents, selection), selection.slots, tuple(notices))


def _of_images(settings: SmoothSettings) -> SmoothSettings:
    """Return settings for images, which have no slots, so that all of them are none."""
    slots = settings.textures.slots or DEFAULTS.textures.slots
    return dataclasses.replace(settings, textures=dataclasses.replace(settings.textures, slots=slots))


def open_both(
    names: tuple[str, str], data: tuple[bytes, bytes], settings: SmoothSettings, job: Job = PLAIN_JOB
) -> tuple[Document, Document]:
    """Open both; one may be a level set, and the other the mesh that was made of it."""
    volumes = [kind_of(each, name) == "volume" for each, name in zip(data, names, strict=True)]
    plain = dataclasses.replace(settings, level_set=LevelSetSettings()) if any(volumes) else settings
    sources = [*zip(data, names, volumes, strict=True)]
    one, other = (
        document_from(each, name, settings if volume else plain, job.access)
        for each, name, volume in tracked(sources, "reading", job.progress)
    )
    return one, other
