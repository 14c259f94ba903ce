"""Clouds of points: colours without faces, smoothed on the surface that the points lie on."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.samples.vertices.result import CloudCounts, SmoothResult
from beltrami_cli.samples.vertices.smooth import smooth_painted
from beltrami_cli.surface.point_triangulation import faces_of_points

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices


def with_surface(painted: PaintedVertices, settings: SmoothSettings) -> PaintedVertices:
    """Return painted vertices with triangles: their own, or if they have none those of the surface that they lie on.

    Parameters
    ----------
    painted : PaintedVertices
        As a document gives it.
    settings : SmoothSettings
        How many threads there are.

    Returns
    -------
    PaintedVertices
        Points that are too far from all others, or in one line with them, are in no triangle; nor are those whose
        position is not finite, which then is the middle of the others.

    Raises
    ------
    UsageError
        If positions are to be smoothed, which takes triangles with an inside and an outside.
    """
    if len(painted.faces):
        return painted
    if settings.embedding.smooth_geometry:
        raise UsageError("smooth_geometry needs faces, but there are only points")
    measured = np.asarray(np.isfinite(painted.positions).all(axis=1))
    if measured.all():
        return dataclasses.replace(painted, faces=faces_of_points(painted, settings.kernel.thread_count))
    spaces = painted.space_of
    there = dataclasses.replace(
        painted,
        positions=painted.positions[measured],
        colours=painted.colours[measured],
        space_of=None if spaces is None else spaces[measured],
    )
    rows = np.flatnonzero(measured).astype(np.int32)
    middle = there.positions.mean(axis=0) if len(rows) else np.zeros(painted.positions.shape[1])
    return dataclasses.replace(
        painted,
        positions=np.where(measured[:, None], painted.positions, middle),
        faces=rows[faces_of_points(there, settings.kernel.thread_count)],
    )


def count_cloud(surface: PaintedVertices) -> CloudCounts:
    """Count what `with_surface` found between points."""
    joined = np.zeros(len(surface.positions), bool)
    joined[surface.faces] = True
    return CloudCounts(len(surface.faces), int(np.count_nonzero(~joined)))


def smooth_cloud(
    painted: PaintedVertices,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
    guides: Sequence[Guide] = (),
) -> SmoothResult:
    """Smooth the colours of points without faces; otherwise as `smooth_painted`.

    Returns
    -------
    SmoothResult
        With `cloud`. Outliers keep their colours.

    Raises
    ------
    UsageError
        As `with_surface` and `smooth_painted`.
    """
    surface = with_surface(painted, settings)
    result = smooth_painted(surface, settings, progress, guides)
    return dataclasses.replace(result, cloud=count_cloud(surface))
