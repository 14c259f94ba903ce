"""The charts of a textured surface, and its seams."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s, Int64s
from beltrami_cli.surface.grouping import connected, group_places
from beltrami_cli.surface.records import TexturedSurface


def charts_of(surface: TexturedSurface) -> tuple[Int32s, Int64s]:
    """Return the chart of each triangle, and the seams, (K, 2), as triangles and the corners they begin at."""
    place_of, _ = group_places(surface.positions, surface.space_of, surface.faces)
    starts = place_of[surface.faces]
    ends = np.roll(starts, -1, axis=1)
    uv = np.stack([surface.uv, np.roll(surface.uv, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    turned = (starts > ends).reshape(-1)
    uv[turned] = uv[turned, ::-1]
    low, high = np.minimum(starts, ends).reshape(-1), np.maximum(starts, ends).reshape(-1)
    order = np.lexsort((high, low))
    equal = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    here, there = order[:-1][equal], order[1:][equal]
    same = surface.texture_of[here // 3] == surface.texture_of[there // 3]
    same &= (uv[here] == uv[there]).all(axis=(1, 2))
    chart_of = connected(len(surface.faces), np.stack([here[same] // 3, there[same] // 3], axis=1))
    cut = np.concatenate([here[~same], there[~same]])
    cut = cut[surface.texture_of[cut // 3] >= 0]
    return chart_of, np.stack([cut // 3, cut % 3], axis=1)


def ends_of(corners: Float64s, edges: Int64s) -> Float64s:
    """Return both ends of edges, given by triangle and first corner, (2 K, X)."""
    face, corner = edges.T
    pairs = np.stack([corners[face, corner], corners[face, (corner + 1) % 3]], axis=1)
    return np.asarray(pairs.reshape(-1, corners.shape[2]), np.float64)
