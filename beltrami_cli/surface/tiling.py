"""Textures in tiles (UDIM): triangles are cut along unit squares of the UV plane, each of which has its own image.

Tile (u, v) has its lower left corner at (u, v).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import TexturedSurface

Tile: TypeAlias = tuple[int, int]
"""Column and row of a unit square of the UV plane, (0, 0) the first, rows counted upwards."""

COLUMNS, ROWS = 10, 900
"""How many there are: the numbers from 1001 to 9999."""

_MAX_NEW = 1 << 18  # new triangles beyond four times the original number
_BORDER_TOLERANCE = 1e-9  # a border that an edge crosses this close to its end is none


def on_tiles(
    surface: TexturedSurface, set_of: Int32s, sets: Sequence[Mapping[Tile, int]], name: str
) -> TexturedSurface:
    """Assign the texture of their tile, if there is one, to the triangles of tile sets.

    `set_of`, (F,), is the set of each triangle, -1: none. InputError with the name if they span more tiles than those
    of any real model.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates are undefined without a texture
        surface, set_of = _cut(surface, set_of, name)
    texture_of, uv = surface.texture_of.copy(), surface.uv.copy()
    for number, known in enumerate(sets):
        faces = np.flatnonzero(set_of == number)
        tiles = tiles_under(uv[faces])
        uv[faces] += np.column_stack([-tiles[:, 0], tiles[:, 1]])[:, None]
        images = np.full((COLUMNS, ROWS), -1, np.int32)
        for (column, row), image in known.items():
            images[column, row] = image
        inside = np.asarray(((tiles >= 0) & (tiles < (COLUMNS, ROWS))).all(axis=1))
        column, row = np.where(inside[:, None], tiles, 0).astype(np.int64).T
        texture_of[faces] = np.where(inside, images[column, row], -1)
    return dataclasses.replace(surface, uv=uv, texture_of=texture_of)


def tiles_under(uv: Float64s) -> Float64s:
    """Return column and row of the tile at each triangle's centre, (F, 2), from coordinates (F, 3, 2) with v down."""
    centre = uv.mean(axis=1)
    return np.asarray(np.floor(np.column_stack([centre[:, 0], 1 - centre[:, 1]])))


def _cut(surface: TexturedSurface, set_of: Int32s, name: str) -> tuple[TexturedSurface, Int32s]:
    """Cut triangles of tile sets at the borders of tiles, and their neighbours there, so that edges still match."""
    most = 4 * len(surface.faces) + _MAX_NEW
    while True:
        place_of, first = group_places(surface.positions, surface.space_of, surface.faces)
        ends = place_of[np.stack([surface.faces, np.roll(surface.faces, -1, axis=1)], axis=2)]
        share = _crossings(surface.uv, ends)
        share[set_of < 0] = np.nan
        crossed = ~np.isnan(share)
        if not crossed.any():
            return surface, set_of
        keys = ends.min(axis=2).astype(np.int64) * len(first) + ends.max(axis=2)
        cut, chosen = np.unique(keys[crossed], return_index=True)
        at = share[crossed][chosen]  # from the end with the lower place number
        number = np.minimum(np.searchsorted(cut, keys), len(cut) - 1)
        is_cut = cut[number] == keys
        along = np.where(ends[:, :, 0] < ends[:, :, 1], at[number], 1 - at[number])
        rows = np.where(is_cut, len(surface.positions) + number, -1)
        low, high = (first[part] for part in np.divmod(cut, len(first)))
        start, stop, space_of = surface.positions[low], surface.positions[high], surface.space_of
        if space_of is not None:
            space_of = np.concatenate([space_of, space_of[low]])
        positions = np.concatenate([surface.positions, start + at[:, None] * (stop - start)])
        surface = dataclasses.replace(surface, positions=positions, space_of=space_of)
        surface, origin = _split(surface, rows, along)
        set_of = set_of[origin]
        if len(surface.faces) > most:
            cause = "its triangles repeat their texture more often than any real model does"
            raise InputError(name, cause, "check its texture coordinates")


def _crossings(uv: Float64s, ends: Int32s) -> Float64s:
    """Return where edges cross a border, as the fraction from the end with the lower place, (F, 3); NaN: nowhere."""
    turned = ends[:, :, 0] > ends[:, :, 1]
    one, other = uv, np.roll(uv, -1, axis=1)
    start, stop = np.where(turned[..., None], other, one), np.where(turned[..., None], one, other)
    shares = np.full(turned.shape, np.nan)
    for axis, last in ((0, COLUMNS), (1, ROWS)):
        # With v down the borders are the integers from 1 downwards.
        below, above = (0, last) if axis == 0 else (1 - last, 1)
        a, b = start[..., axis], stop[..., axis]
        low, high = np.maximum(np.minimum(a, b), below - 0.5), np.minimum(np.maximum(a, b), above + 0.5)
        border = np.clip(np.floor((low + high) / 2), np.floor(low) + 1, np.ceil(high) - 1)
        crosses = (border > low) & (border < high)
        at = np.divide(border - a, b - a, out=np.full(a.shape, np.nan), where=crosses)
        at[~((at > _BORDER_TOLERANCE) & (at < 1 - _BORDER_TOLERANCE))] = np.nan
        shares = np.where(np.isnan(shares), at, shares)
    return shares


def _split(
    surface: TexturedSurface, new_of: Int64s, before: Float64s
) -> tuple[TexturedSurface, NDArray[np.intp]]:
    """Split each triangle with cut edges into up to four, around the first new vertex; return also their origins.

    Edges, (F, 3), lead from each corner to the next. For each, `new_of` has the row of its new vertex (-1: none), and
    `before` the fraction of the edge before that.
    """
    touched = (new_of >= 0).any(axis=1)
    faces = np.flatnonzero(touched)
    turn = (np.argmax(new_of[faces] >= 0, axis=1)[:, None] + np.arange(3)) % 3
    places = faces[:, None], turn
    corner, uv, row, share = surface.faces[places], surface.uv[places], new_of[places], before[places]
    between = uv + share[..., None] * (np.roll(uv, -1, axis=1) - uv)
    whole = np.rint(between)
    between = np.where(np.abs(between - whole) < _BORDER_TOLERANCE, whole, between)
    # An uncut edge uses an end for its vertex, which makes a degenerate triangle, removed below.
    end = [1, 1, 0]
    rows = np.concatenate([np.where(row >= 0, row, corner[:, end]), corner], axis=1)
    coordinates = np.concatenate([np.where((row >= 0)[..., None], between, uv[:, end]), uv], axis=1)
    parts = np.array([[0, 4, 1], [0, 1, 5], [0, 5, 2], [0, 2, 3]])
    new, new_uv = rows[:, parts].reshape(-1, 3), coordinates[:, parts].reshape(-1, 3, 2)
    is_real = (new != np.roll(new, 1, axis=1)).all(axis=1)
    kept = np.flatnonzero(~touched)
    origin = np.concatenate([kept, np.repeat(faces, len(parts))[is_real]])
    split = dataclasses.replace(
        surface,
        faces=np.concatenate([surface.faces[kept], new[is_real]]).astype(np.int32),
        uv=np.concatenate([surface.uv[kept], new_uv[is_real]]),
        texture_of=surface.texture_of[origin],
    )
    return split, origin
