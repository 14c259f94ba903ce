"""Colours on both sides of the seams of a surface, averaged over short stretches, and the places of these in charts."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface.atlas import Atlas, Indices, at_seam, lines_over_seams, refresh_halo
from beltrami_cli.surface.records import limits_of

# Side of the blocks of cells whose steps are averaged: doubled until there are few enough of them.
STRETCH = 4
_MOST = 24_000
# Deviations of 8-bit colours are not known better than this.
FINEST = 1 / 255
# Independent measurements in a seam, at most: its texels share errors. Hand-set.
PARTS = 8
# Beside 0 and full scale a colour was cut off there; a stretch was, of which more than this share of the lines was.
_CUT_OFF, _CUT_SHARE = 0.6 / 255, 0.1
_CELLS = 1 << 20  # whose places are added up at a time
_LEAST_SPREAD = 1e-3  # of the directions to neighbours, beside the largest, for which a slope is known


@dataclass(frozen=True)
class Steps:
    """Stretches of seams, K of them, and the colours of their two sides."""

    charts: int
    ends: Int64s  # (K, 2): the charts on the two sides
    colours: Float64s  # (K, 2, N)
    places: Float64s  # (K, 2, 2): in the charts, about their centres, of deviation 1/2
    seams: Int64s  # (K,): the seam that a stretch is of
    counts: Float64s  # (K,): texels in it
    low: Bools  # (K, 2, N): where colours of a side were cut off at 0, so that these are upper bounds
    high: Bools  # (K, 2, N): where they were cut off at full scale

    def part(self, rows: Bools) -> Steps:
        """Return some of the stretches."""
        charts, *others = (getattr(self, each.name) for each in fields(self))
        return Steps(charts, *(each[rows] for each in others))


@dataclass(frozen=True)
class ChartPlaces:
    """Where the owned cells of each chart lie on the canvas: their centre and twice their deviation."""

    centre: Float64s  # (charts, 2): row and column
    scale: Float64s
    areas: Float64s  # (charts,): owned cells

    @classmethod
    def of(cls, atlas: Atlas) -> ChartPlaces:
        """Measure the charts of an atlas."""
        count = max(1, atlas.charts)
        areas, first, second = np.zeros(count), np.zeros((count, 2)), np.zeros((count, 2))
        middle = np.array(atlas.kind.shape) / 2
        for begin in range(0, len(atlas.owned_cells), _CELLS):
            block = slice(begin, begin + _CELLS)
            charts = atlas.chart_of[block]
            cells = np.divmod(atlas.owned_cells[block], atlas.kind.shape[1])
            areas += np.bincount(charts, minlength=count)
            for axis in (0, 1):
                at = cells[axis] - middle[axis]
                first[:, axis] += np.bincount(charts, at, count)
                second[:, axis] += np.bincount(charts, at * at, count)
        share = np.maximum(areas, 1)[:, None]
        variance = np.maximum(second / share - np.square(first / share), 1.0)
        return cls(first / share + middle, 2 * np.sqrt(variance), areas)

    def at(self, cells: Indices, charts: Indices, columns: int) -> Float64s:
        """Return the places of some cells in their charts, shape (K, 2)."""
        found = np.column_stack(np.divmod(cells, columns))
        return (found - self.centre[charts]) / self.scale[charts]


def steps_over_seams(atlas: Atlas, planes: Float32s, places: ChartPlaces) -> Steps:
    """Measure the colours of both sides of all seams of an atlas; its halo is interpolated in place."""
    refresh_halo(planes, atlas, interpolated=True)
    inner, outer, colours, cut = _both_sides(atlas, planes)
    halo = np.searchsorted(atlas.halo_cells, outer)
    cells = np.column_stack([inner, atlas.halo_nearest[halo]]).astype(np.int64)
    ends = atlas.chart_of[np.searchsorted(atlas.owned_cells, cells)].astype(np.int64)
    columns = atlas.kind.shape[1]
    where = np.stack([places.at(cells[:, side], ends[:, side], columns) for side in (0, 1)], axis=1)
    seams = atlas.halo_seams[halo].astype(np.int64)
    found = Steps(atlas.charts, ends, colours, where, seams, np.ones(len(seams)), *cut)
    keys = np.column_stack([seams, ends, *np.divmod(inner.astype(np.int64), columns)])
    keys[:, 3:] //= STRETCH
    stretches = keys
    while len(stretches := _ordered(stretches)[1]) > _MOST:
        stretches[:, 3:] //= 2
        keys[:, 3:] //= 2
    return _with_less_error(_merged(found, keys))


def _with_less_error(steps: Steps) -> Steps:
    """Take the colours at the seam, or halfway to the means of the lines, which have less noise, but slopes."""
    exact, means = np.split(steps.colours, 2, axis=2)
    sharp, soft = (replace(steps, colours=each) for each in (exact, (exact + means) / 2))
    if not len(steps.seams):
        return sharp
    starts, lengths, _ = runs(steps)
    change = oriented(steps, (np.diff(soft.colours, axis=1) - np.diff(exact, axis=1))[:, 0])
    by_slopes = np.square(np.add.reduceat(change, starts) / lengths[:, None]).mean(axis=1)
    of_noise = [np.square(deviations(each, each.colours)[starts]) / PARTS for each in (sharp, soft)]
    before, after = (weighted_median(each, lengths) for each in (of_noise[0], of_noise[1] + by_slopes))
    return soft if after < before else sharp


def _both_sides(atlas: Atlas, planes: Float32s) -> tuple[Int64s, Int64s, Float64s, tuple[Bools, Bools]]:
    """Return the cells on both sides of seams, the colours there, and which were cut off."""
    flat = planes.reshape(len(planes), -1)
    inner, outer, colours, low, high = [], [], [], [], []
    known, (floor, ceiling) = np.zeros(max(1, atlas.seams), bool), limits_of(planes)
    for reach in (3, 1):
        for line in lines_over_seams(atlas, reach):
            seams = atlas.halo_seams[np.searchsorted(atlas.halo_cells, line[reach])]
            wanted = np.ones(len(seams), bool) if reach > 1 else ~known[seams]
            cells = [each[wanted] for each in line]
            inner.append(cells[0])
            outer.append(cells[reach])
            halves = [[flat[:, each] for each in half] for half in (cells[:reach], cells[reach:])]
            colours.append(
                np.stack([np.concatenate([at_seam(half), np.mean(half, axis=0)]) for half in halves])
            )
            low.append(np.stack([np.min(half, axis=0) <= floor + _CUT_OFF for half in halves]))
            high.append(np.stack([np.max(half, axis=0) >= ceiling - _CUT_OFF for half in halves]))
        # Charts may be too narrow for lines of three cells.
        for cells_beyond in outer:
            known[atlas.halo_seams[np.searchsorted(atlas.halo_cells, cells_beyond)]] = True
        if known.all():
            break
    both, *cut = (np.concatenate(each, axis=2).transpose(2, 0, 1) for each in (colours, low, high))
    return np.concatenate(inner), np.concatenate(outer), both, (cut[0], cut[1])


def _ordered(keys: Int64s) -> tuple[Int64s, Int64s, Int64s]:
    """Return the order of rows, the different ones in that order, and where each begins."""
    order = np.lexsort(keys.T[::-1])
    ordered = keys[order]
    starts = np.flatnonzero(np.r_[True, np.any(ordered[1:] != ordered[:-1], axis=1)][: len(ordered)])
    return order, ordered[starts], starts


def _merged(steps: Steps, keys: Int64s) -> Steps:
    """Average the steps of equal rows."""
    order, _, starts = _ordered(keys)
    counts = np.add.reduceat(steps.counts[order], starts) if len(starts) else np.zeros(0)

    def mean(values: Float64s | Bools) -> Float64s:
        if not len(starts):
            return values.astype(np.float64)
        sums = np.add.reduceat(values[order], starts, dtype=np.float64)
        return np.asarray(sums / counts[:, None, None])

    first, sides = order[starts], (mean(steps.colours), mean(steps.places))
    cut = mean(steps.low) > _CUT_SHARE, mean(steps.high) > _CUT_SHARE
    return Steps(steps.charts, steps.ends[first], *sides, steps.seams[first], counts, *cut)


def runs(steps: Steps) -> tuple[Int64s, Int64s, Int64s]:
    """Return where the stretches of each seam begin, how many these are, and the seam of each stretch from 0."""
    starts = np.flatnonzero(np.r_[True, steps.seams[1:] != steps.seams[:-1]][: len(steps.seams)])
    lengths = np.diff(np.r_[starts, len(steps.seams)])
    return starts, lengths, np.repeat(np.arange(len(starts)), lengths)


def parts_of(steps: Steps) -> Int64s:
    """Return the part of a seam that each stretch is in, `PARTS` numbers for each seam, in equal parts."""
    starts, lengths, run = runs(steps)
    within = np.arange(len(run)) - starts[run]
    return np.asarray(run * PARTS + within * PARTS // np.maximum(lengths, PARTS)[run])


def oriented(steps: Steps, differences: Float64s) -> Float64s:
    """Orient differences of the second side from the first towards the chart with the higher number."""
    return np.where((steps.ends[:, 0] <= steps.ends[:, 1])[:, None], differences, -differences)


def deviations(steps: Steps, sides: Float64s) -> Float64s:
    """Return for each stretch the deviation of steps between corrected sides along its seam, shape (K,)."""
    starts, lengths, run = runs(steps)
    if not len(run):
        return np.zeros(0)
    found = np.zeros(len(starts))
    for column in oriented(steps, sides[:, 1] - sides[:, 0]).T:
        middle = _medians(column, run, starts, lengths)
        found += _medians(np.abs(column - middle[run]), run, starts, lengths)
    found *= 1.4826 / sides.shape[2]
    usual = weighted_median(found, np.add.reduceat(steps.counts, starts))
    # Of few stretches little is known, so that they are taken for usual ones.
    whole = np.sqrt((lengths * np.square(found) + PARTS * usual**2) / (lengths + PARTS))
    return np.asarray(np.maximum(whole, FINEST)[run])


def _medians(values: Float64s, run: Int64s, starts: Int64s, lengths: Int64s) -> Float64s:
    return np.asarray(values[np.lexsort((values, run))][starts + lengths // 2])


def weighted_median(values: Float64s, weights: NDArray[np.number[Any]]) -> float:
    """Return the value below which half of the weight is."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def steps_over_edges(
    positions: Float64s, faces: Int32s, colours: Float64s, photographs: Int64s
) -> tuple[Steps, Indices, Float64s]:
    """Measure the steps over edges of a mesh between photographs; also return each vertex' chart and place in it.

    A chart is what edges join of one photograph.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(pairs, axis=0).astype(np.int64)
    inside = edges[photographs[edges[:, 0]] == photographs[edges[:, 1]]]
    joined = coo_array((np.ones(len(inside)), (inside[:, 0], inside[:, 1])), shape=(len(positions),) * 2)
    count, charts = connected_components(joined, directed=False)
    places = _places(positions, charts, count)
    across = edges[charts[edges[:, 0]] != charts[edges[:, 1]]]
    backwards = charts[across[:, 0]] > charts[across[:, 1]]
    across[backwards] = across[backwards][:, ::-1]
    ends = charts[across].astype(np.int64)
    order = np.lexsort(ends.T[::-1])
    across, ends = across[order], ends[order]
    seams = np.unique(ends, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    slopes = _slopes(positions, colours, inside)
    half = (positions[across[:, 1]] - positions[across[:, 0]]) / 2
    sides = [
        colours[across[:, side]] + sign * np.einsum("kx,kxn->kn", half, slopes[across[:, side]])
        for side, sign in ((0, 1.0), (1, -1.0))
    ]
    floor, ceiling = limits_of(colours)
    cut = colours[across] <= floor + _CUT_OFF, colours[across] >= ceiling - _CUT_OFF
    steps = Steps(count, ends, np.stack(sides, axis=1), places[across], seams, np.ones(len(ends)), *cut)
    return steps, charts, places


def _places(positions: Float64s, charts: Indices, count: int) -> Float64s:
    """Return the places of vertices in their charts, on the plane of the two directions in which all is longest."""
    centred = positions - positions.mean(axis=0)
    flat = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -2:]
    sizes = np.maximum(np.bincount(charts, minlength=count), 1)[:, None]
    centre = np.column_stack([np.bincount(charts, axis, count) for axis in flat.T]) / sizes
    squares = np.square(flat - centre[charts])
    deviation = np.sqrt(np.column_stack([np.bincount(charts, axis, count) for axis in squares.T]) / sizes)
    return np.asarray((flat - centre[charts]) / np.where(deviation > 0, 2 * deviation, 1)[charts])


def _slopes(positions: Float64s, colours: Float64s, edges: Int64s) -> Float64s:
    """Return the slope of colours at each vertex, shape (S, 3, N), by least squares over its edges."""
    directions = positions[edges[:, 1]] - positions[edges[:, 0]]
    rises = colours[edges[:, 1]] - colours[edges[:, 0]]
    spreads = np.zeros((len(positions), 3, 3))
    products = np.zeros((len(positions), 3, colours.shape[1]))
    for side in (0, 1):  # both signs of an edge give the same products
        np.add.at(spreads, edges[:, side], directions[:, :, None] * directions[:, None, :])
        np.add.at(products, edges[:, side], directions[:, :, None] * rises[:, None, :])
    size = np.trace(spreads, axis1=1, axis2=2)
    spreads += np.where(size > 0, _LEAST_SPREAD * size, 1.0)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(spreads, products))
