"""The vertex colours of two models, vertex by vertex."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.flow.colour_space import to_space
from beltrami_cli.jobs.compare.paired_colours import PairedColours, SeamSteps, differences
from beltrami_cli.jobs.noise.vertices import coloured_vertices, places_of
from beltrami_cli.samples.vertices.channels import choose_channels
from beltrami_cli.samples.vertices.level_set import LevelSetDocument
from beltrami_cli.samples.vertices.point_cloud import with_surface
from beltrami_cli.surface.geometry import vertex_areas

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import Weights
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings.smooth import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices

# Positions that two files of one model may differ by, of the model's size: text is often rounded to six digits.
_ROUNDING = 1e-5


def pair_vertices(
    reference: Document, test: Document, settings: SmoothSettings, weights: Weights
) -> tuple[PairedColours, tuple[str, ...]]:
    """Bring the vertex colours of two models together.

    Parameters
    ----------
    reference, test : Document
        With vertex colours.
    settings : SmoothSettings
        The working space and the channels.
    weights : {"uniform", "area"}
        Whether each vertex counts once, or by the area around it.

    Returns
    -------
    pair : PairedColours
    notices : tuple of str
        What the user should know, one sentence each.

    Raises
    ------
    InputError
        If the models have not the same vertices and triangles, or not the same channels.
    """
    one, other = reference.painted(), test.painted()
    require_alike(triangles(reference), triangles(test), (one, other), (reference.name, test.name))
    if one.channels != other.channels:
        cause = f"its colours are {', '.join(other.channels)}, but those of {reference.name} {', '.join(one.channels)}"
        raise InputError(test.name, cause, "compare files with the same channels")
    moved = largest_move(one, other)
    if not len(one.faces) and moved > 1:
        raise InputError(test.name, f"its points are not where those of {reference.name} are", _OTHER_MODEL)
    rows = np.flatnonzero(coloured_vertices(reference) & coloured_vertices(test))
    channels = choose_channels(one, settings).changing
    colours = [
        to_space(painted.colours[rows][:, channels], painted.encoding, settings.space)
        for painted in (one, other)
    ]
    _require_finite(colours[1], test.name)
    place = places_of(one, rows)
    split = np.bincount(place)[place] > 1 if len(place) else np.zeros(0, bool)
    pair = PairedColours(
        "vertex colours",
        "vertices",
        colours[0],
        colours[1],
        rows.astype(np.int64),
        _areas(one, rows, settings) if weights == "area" else np.ones(len(rows)),
        differences(colours[0], colours[1], settings.space),
        near_seams=split if split.any() else None,
        steps=_steps(colours, place) if split.any() else None,
    )
    notices = ("its vertices are not where those of the reference are; only colours are compared",)
    return pair, notices if moved > 1 else ()


_OTHER_MODEL = "compare two files of one model"


def triangles(document: Document) -> NDArray[np.int32]:
    """Return the triangles of a model, shape (F, 3); of a level set those without colours too."""
    if isinstance(document, LevelSetDocument):
        return document.contents().corners.reshape(-1, 3)
    return document.painted().faces


def require_alike(
    faces: NDArray[np.int32],
    others: NDArray[np.int32],
    painted: tuple[PaintedVertices, PaintedVertices],
    names: tuple[str, str],
) -> None:
    """Raise InputError if two models have not the same numbers of vertices, or not the same triangles."""
    counts = [len(vertices.positions) for vertices in painted]
    if counts[0] != counts[1]:
        raise InputError(
            names[1], f"it has {counts[1]} coloured vertices, but {names[0]} {counts[0]}", _OTHER_MODEL
        )
    require_same_triangles(faces, others, names)


def require_same_triangles(
    faces: NDArray[np.int32], others: NDArray[np.int32], names: tuple[str, str]
) -> None:
    """Raise InputError if two models have not the same triangles."""
    if len(faces) != len(others):
        raise InputError(
            names[1], f"it has {len(others)} triangles, but {names[0]} {len(faces)}", _OTHER_MODEL
        )
    if not np.array_equal(faces, others):
        first = int((faces != others).any(axis=1).argmax())
        raise InputError(names[1], f"its triangle {first} is another than that of {names[0]}", _OTHER_MODEL)


def largest_move(one: PaintedVertices, other: PaintedVertices) -> float:
    """Return how far vertices are from each other at most, in units of what rounding explains."""
    known = np.isfinite(one.positions).all(axis=1) & np.isfinite(other.positions).all(axis=1)
    if not known.any():
        return 0.0
    places = one.positions[known]
    size = float((places.max(axis=0) - places.min(axis=0)).max()) + float(np.abs(places).max()) * 1e-2
    move = float(np.abs(other.positions[known] - places).max())
    return move / (_ROUNDING * size) if size > 0 else np.inf * (move > 0) if move else 0.0


def _areas(painted: PaintedVertices, rows: NDArray[np.intp], settings: SmoothSettings) -> NDArray[np.float64]:
    """Return the area that each vertex stands for; of points, on the surface that they lie on."""
    if len(painted.faces):
        return vertex_areas(painted.positions, painted.faces)[rows].astype(np.float64)
    spaces = None if painted.space_of is None else painted.space_of[rows]
    known = dataclasses.replace(
        painted, positions=painted.positions[rows], colours=painted.colours[rows], space_of=spaces
    )
    surface = with_surface(known, settings)
    return vertex_areas(surface.positions, surface.faces).astype(np.float64)


def _steps(colours: list[NDArray[np.float32]], place: NDArray[np.int32]) -> SeamSteps:
    """Measure how far the colours of vertices at one place are from each other: mean of the channels' ranges."""
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.r_[True, place[order][1:] != place[order][:-1]])
    several = np.diff(np.r_[starts, len(order)]) > 1
    reference, test = (
        (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).mean(axis=1)
        for values in colours
    )
    return SeamSteps(reference[several].astype(np.float64), test[several].astype(np.float64))


def _require_finite(colours: NDArray[np.float32], name: str) -> None:
    if not np.isfinite(colours).all():
        raise InputError(name, "some of its colours are no finite numbers, which cannot be compared")
