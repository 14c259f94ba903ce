"""Compare the colours of two files, check the difference against limits, and draw it.

A map is a picture, or a mesh of the vertices, to look at: dark where the files are equal, bright where they differ.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s, Uint8s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import require_effect
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.ply.writer import write_scalars_as_ply
from beltrami_cli.jobs.compare.figures import (
    ComparedColours,
    Measured,
    Verdict,
    check_limits,
    figures,
    measure,
)
from beltrami_cli.jobs.compare.parts import (
    ROUNDED_MOVE,
    Documents,
    compare_images,
    compare_textures,
    compare_vertices,
    moves_of,
)
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.output import Output, Overwrite
from beltrami_cli.jobs.progress import phases_of, tracked
from beltrami_cli.jobs.recolour import open_any, require_level_set
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.layers.selection import Selection, absent_slots, select
from beltrami_cli.layers.settings import DEFAULTS, IMAGE_SUFFIXES, SLOTS, SmoothSettings
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import as_bytes, colour_by_value
from beltrami_cli.surface.records import Slot

ALL_SLOTS = dataclasses.replace(DEFAULTS, textures=dataclasses.replace(DEFAULTS.textures, slots=()))
"""Settings of a comparison of all that is coloured: where no slots are named, all are compared."""

_NO_LIMITS = Limits()
# The brightest colour stands for this Delta E 2000 at least: 1 can hardly be seen.
_MIN_SCALE = 1.0
_GAP = 8  # pixels between images
_ROWS = 256  # of an image, drawn at a time
_SCALAR = b"\nproperty uchar blue\nproperty float "  # of the header, where the numbers follow the colours
_SUFFIXES = (".ply", *IMAGE_SUFFIXES)


@dataclass(frozen=True)
class Moves:
    """Distances of vertices from the reference, in units of the longest side of its bounding box."""

    largest: float
    mean: float

    @property
    def is_rounding(self) -> bool:
        """Whether the rounding of numbers in text explains the distances."""
        return self.largest <= ROUNDED_MOVE


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
        output = _opened_map(os.fspath(map_to), names, settings, overwrite)
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
    passed = all(verdict.kept for verdict in verdicts)
    notices = [*compared.all_notices(), *untested]
    return Comparison(
        *names, weights, settings.space, described, compared.overall(), moves, verdicts, passed, scale,
        notices,
    )  # fmt: skip


def _opened_map(
    target: str, names: tuple[str, str], settings: SmoothSettings, overwrite: Overwrite
) -> Output:
    """Check that a map can be written before anything is compared."""
    if Path(target).suffix.lower() not in _SUFFIXES:
        raise UsageError("a map is drawn as .png, or of vertices as .ply; end the name in one", target)
    output = Output(target, overwrite=overwrite, what="map", is_own=is_map, reads=names)
    output.files.guard(settings.input_files())
    return output


def require_samples(parts: Sequence[ComparedColours], name: str) -> None:
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


def choose_parts(documents: Documents, settings: SmoothSettings) -> tuple[Selection, list[str]]:
    """Choose the compared parts, by default all coloured ones; return notices on all others."""
    kinds = ["an image" if document.kind == "image" else "a model" for document in documents]
    if kinds[0] != kinds[1]:
        cause = f"it is {kinds[1]}, but {documents[0].name} is {kinds[0]}"
        raise InputError(documents[1].name, cause, "compare two files of one kind")
    if documents[0].kind == "image":
        selection = Selection(documents[0], settings, documents[0].access, image=True)
        require_effect(selection.kinds, documents[0].name)
        return selection, []
    notices: list[str] = []
    chosen = settings if settings.textures.slots else _everything(documents, settings, notices)
    selection = select(documents[0], chosen)
    notices += absent_slots(documents[0], chosen) if selection.slots else []
    uncompared = [f"{slot} textures" for slot in _slots_of(documents) if slot not in selection.slots]
    if not selection.vertices and any(document.has_vertex_colours() for document in documents):
        uncompared.insert(0, "vertex colours")
    if settings.textures.names or settings.textures.materials:
        uncompared.append("textures that --texture and --material leave out")
    if settings.channels is not None:
        uncompared.append("other channels")
    return selection, [*notices, *([f"not compared: {', '.join(uncompared)}"] if uncompared else [])]


def _slots_of(documents: Documents) -> tuple[Slot, ...]:
    known = {slot for document in documents for slot in document.slots()}
    return tuple(sorted(known, key=SLOTS.index))


def _everything(documents: Documents, settings: SmoothSettings, notices: list[str]) -> SmoothSettings:
    """Return settings that select all coloured parts of both models; InputError if only one model has some part."""
    slots = () if settings.on == "vertices" else _slots_of(documents)
    for slot in slots:
        _require_both(documents, [slot in document.slots() for document in documents], f"{slot} textures")
    slots = tuple(slot for slot in slots if _is_readable(documents, slot, notices))
    has_globs = bool(settings.textures.names or settings.textures.materials)
    vertices = settings.on != "texture" and not (settings.on == "auto" and has_globs and slots)
    if vertices and slots:
        coloured = [document.has_vertex_colours() for document in documents]
        _require_both(documents, coloured, "vertex colours")
        vertices = settings.on == "both" or all(coloured)
    textures = dataclasses.replace(settings.textures, slots=slots or DEFAULTS.textures.slots)
    on = settings.on
    if slots:
        on = "both" if vertices else "texture"
    return dataclasses.replace(settings, on=on, textures=textures)


def _require_both(documents: Documents, has: list[bool], what: str) -> None:
    if has[0] != has[1]:
        names = [documents[not has[0]].name, documents[has[0]].name]
        cause = f"it has no {what}, but {names[0]} has"
        raise InputError(names[1], cause, "choose what both have with --slots or --on")


def _is_readable(documents: Documents, slot: Slot, notices: list[str]) -> bool:
    """Whether the textures of a slot can be read in both models; raises the error if only in one."""
    errors = []
    for document in documents:
        try:
            document.textured(slot)
        except InputError as error:
            errors.append(error)
    if len(errors) == 1:
        raise errors[0]
    notices += [f"not compared: {slot} textures, because {error.cause}" for error in errors[:1]]
    return not errors


def moves_between(documents: Documents, selection: Selection) -> Moves:
    """Measure the distances of vertices, in all compared parts."""
    found = [np.zeros(0)]
    if selection.vertices:
        found.append(moves_of(*(document.coloured_vertices().positions for document in documents)))
    if selection.slots:
        surfaces = [document.textured(selection.slots[0]) for document in documents]
        found.append(moves_of(*(surface.positions[surface.faces].reshape(-1, 3) for surface in surfaces)))
    every = np.concatenate(found) if any(moves.size for moves in found) else np.zeros(1)
    return Moves(float(every.max()), float(every.mean()))


def check_moves(moves: Moves, limits: Limits) -> list[Verdict]:
    """Check the geometry against its limit; if only other limits are given, against the rounding of text."""
    if all(allowed is None for allowed in vars(limits).values()):
        return []
    allowed = ROUNDED_MOVE if limits.max_move is None else limits.max_move
    return [Verdict("max_move", "geometry", allowed, moves.largest, moves.largest <= allowed)]


@dataclass(frozen=True)
class Compared:
    """The common parts of two documents, and their differences."""

    measured: list[Measured]  # the vertices first
    moves: Moves | None = None  # of the vertices of a model
    slots: tuple[Slot, ...] = ()  # whose textures are among the parts
    notices: tuple[str, ...] = ()

    @property
    def parts(self) -> list[ComparedColours]:
        return [measured.part for measured in self.measured]

    def differing(self) -> list[Measured]:
        """Return the parts that have figures."""
        return [measured for measured in self.measured if not measured.part.is_identical]

    def overall(self) -> dict[str, Any]:
        return figures(self.differing())

    def all_notices(self) -> list[str]:
        """Return notices for users, above all on colours that are not compared."""
        found = [*self.notices]
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
) -> Compared:
    """Compare the colours of two models, or of two images; `further` phases of progress follow."""
    selection, notices = choose_parts(documents, settings)
    samples = sum(selection.samples())
    job.expect(phases_of(["comparing", "measuring", *further], samples))
    for document in documents:
        dataclasses.replace(selection, document=document, access=job.access).require_memory()
    steps: list[Callable[[], list[ComparedColours]]] = []
    if selection.image:
        steps.append(lambda: [compare_images(documents, settings, job.access)])
    if selection.vertices:
        is_extra = bool(selection.slots)
        steps.append(lambda: [compare_vertices(documents, settings, weights, is_extra=is_extra)])
    for slot in selection.slots:
        options = {"is_extra": slot != selection.slots[0]}
        steps.append(partial(compare_textures, documents, slot, settings, weights, job.access, **options))
    parts = [part for step in tracked(steps, "comparing", job.progress) for part in step()]
    moves = None if selection.image else moves_between(documents, selection)
    return Compared(_measured(parts, job), moves, selection.slots, tuple(notices))


def _measured(parts: Sequence[ComparedColours], job: Job) -> list[Measured]:
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


def is_map(head: bytes) -> bool:
    """Whether the first bytes of a file belong to a map of vertices; pictures have no mark."""
    return head.startswith(b"ply\n") and _SCALAR in head.partition(b"end_header\n")[0]


def draw_map(parts: Sequence[Measured], model: Document, target: str) -> tuple[Written, float]:
    """Draw images and textures side by side, or else the vertices; return also what the brightest colour stands for."""
    images, suffix = [each for each in parts if each.part.size is not None], Path(target).suffix.lower()
    on_vertices = parts[0].part.kind == "vertices" and (not images or suffix == ".ply")
    if on_vertices != (suffix == ".ply"):
        form = "vertices is drawn as .ply" if on_vertices else "images and textures is drawn as .png"
        raise UsageError(f"the map of {form}; end its name so", target)
    shown = parts[:1] if on_vertices else images
    # Delta E, or the error in per cent where Delta E is undefined.
    amounts = [np.where(np.isnan(each.delta_e), 100 * each.errors, each.delta_e) for each in shown]
    scale = max(_MIN_SCALE, *(float(each.max(initial=0)) for each in amounts))
    if on_vertices:
        return _draw_vertices(shown[0], amounts[0], scale, model), scale
    panels = [_image_of(each.part, values / scale) for each, values in zip(shown, amounts, strict=True)]
    width = sum(panel.shape[1] + _GAP for panel in panels) - _GAP
    pixels, left = np.full((max(map(len, panels)), width, 3), 255, np.uint8), 0
    for panel in panels:
        pixels[: len(panel), left : left + panel.shape[1]] = panel
        left += panel.shape[1] + _GAP
    return Written([write_image(new_image(pixels, target), pixels, suffix=suffix).data]), scale


def _draw_vertices(measured: Measured, amounts: Float64s, scale: float, document: Document) -> Written:
    """Draw the differences of vertices as a mesh, with delta_e and error (NaN where nothing is compared)."""
    vertices = document.coloured_vertices()
    drawn, delta_e, error = np.full((3, len(vertices.positions)), np.nan, np.float32)
    for table, values in ((drawn, amounts / scale), (delta_e, measured.delta_e), (error, measured.errors)):
        table[measured.part.index] = values
    shades = as_bytes(colour_by_value(drawn, np.ones((len(drawn), 3), np.float32), np.isfinite(drawn)))
    scalars = {"error": error} if np.isnan(delta_e).all() else {"delta_e": delta_e, "error": error}
    return write_scalars_as_ply(np.nan_to_num(vertices.positions), vertices.faces, shades, scalars)


def _image_of(part: ComparedColours, values: Float64s) -> Uint8s:
    """Draw values of samples, white where nothing is compared."""
    covered, drawn = part.covered(), np.empty((*part.covered().shape, 3), np.uint8)
    plane = np.zeros(covered.shape, np.float32)
    plane.reshape(-1)[part.index] = values
    for rows in large_arrays.blocks(len(drawn), _ROWS):
        grey = np.ones(drawn[rows].shape, np.float32)
        drawn[rows] = as_bytes(colour_by_value(plane[rows], grey, covered[rows]))
    return drawn
