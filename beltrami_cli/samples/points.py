"""Clouds of points: the surface that points without faces lie on."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.surface.point_triangulation import faces_of_points

if TYPE_CHECKING:
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices


@dataclass(frozen=True)
class CloudCounts:
    """Triangles around points, each in the tangent plane, and points in none of them, which keep their colours."""

    triangles: int
    outliers: int


def with_surface(painted: PaintedVertices, settings: SmoothSettings) -> PaintedVertices:
    """Return painted vertices with triangles: their own, or else those of the surface that the points lie on.

    Points that are too far from all others, or in one line with them, are in no triangle; nor are those whose
    position is not finite, which then is the middle of the others.
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
