"""Colours on both sides of the seams of a surface, averaged over short stretches, and the places of these in charts."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface.atlas import Atlas, Indices, at_seam, lines_over_seams, refresh_halo
from beltrami_cli.surface.colour_values import limits_of

# Side of the blocks of cells whose steps are averaged: doubled until there are few enough of them.
_STRETCH = 4
_MOST = 24_000
# Along a seam of which each half has a deviation more than this many times the usual one, and this beside it, colours
# are painted.
_UNUSUAL, _ALLOWED = 2.5, 12 / 255
# Deviations of 8-bit colours are not known better than this.
_FINEST = 1 / 255
_PRIOR = 4  # stretches
# Of how many parts of a seam errors are independent at most. Slopes are let in where there are so many seams, whose
# slopes differ, of such errors, and these become so much less.
_PARTS, _MANY, _NOISY, _LESS = 8, 8, 2 / 255, 0.9
# Beside 0 and full scale a colour was cut off there; a stretch was, of which more than this share of the lines was.
_CUT_OFF, _CUT_SHARE = 0.6 / 255, 0.1
_GAINS = (-0.3, -0.15, 0.0, 0.15, 0.3)
UNKNOWN = (np.zeros(0), np.zeros(0, bool))
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
    noise: Float64s  # (K,): deviation of the steps along its seam
    is_paint: Bools  # (K,): whether the steps along each half of its seam vary so much that they are painted

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
    found = Steps(atlas.charts, ends, colours, where, seams, np.ones(len(seams)), *cut, *UNKNOWN)
    keys = np.column_stack([seams, ends, *np.divmod(inner.astype(np.int64), columns)])
    keys[:, 3:] //= _STRETCH
    stretches = keys
    while len(stretches := _ordered(stretches)[1]) > _MOST:
        stretches[:, 3:] //= 2
        keys[:, 3:] //= 2
    return _with_less_error(_merged(found, keys))


def _with_less_error(steps: Steps) -> Steps:
    """Take the colours at the seam, or halfway to the means of the lines: with less noise, but with slopes in them.

    What the two differ by on average over a seam, beyond what varies along it, is of slopes.
    """
    exact, means = np.split(steps.colours, 2, axis=2)
    sharp, soft = (with_noise(replace(steps, colours=each)) for each in (exact, (exact + means) / 2))
    starts = np.flatnonzero(np.r_[True, steps.seams[1:] != steps.seams[:-1]][: len(steps.seams)])
    lengths = np.diff(np.r_[starts, len(steps.seams)])
    is_long = lengths >= _PRIOR
    if np.count_nonzero(is_long) < _MANY:
        return sharp
    signs = np.where(steps.ends[:, 0] <= steps.ends[:, 1], 1.0, -1.0)[:, None]
    change = signs * (np.diff(soft.colours, axis=1) - np.diff(exact, axis=1))[:, 0]
    mean, square = (np.add.reduceat(each, starts) / lengths[:, None] for each in (change, np.square(change)))
    by_slopes = np.square(mean) - (square - np.square(mean)) / np.maximum(lengths - 1, 1)[:, None]
    parts = np.minimum(lengths, _PARTS)

    def median(squares: Float64s) -> float:
        return weighted_median(squares[is_long], parts[is_long])

    before, after = (median(np.square(each.noise[starts]) / parts) for each in (sharp, soft))
    after += max(0.0, median(by_slopes.mean(axis=1)))
    return soft if before > _NOISY**2 and after < _LESS**2 * before else sharp


def _both_sides(atlas: Atlas, planes: Float32s) -> tuple[Int64s, Int64s, Float64s, tuple[Bools, Bools]]:
    """Return the cells on both sides of seams, the colours there, and which were cut off.

    Colours are extrapolated to the seam, and then come the means of the lines.
    """
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
    """Average the steps of rows that are alike."""
    order, _, starts = _ordered(keys)
    counts = np.add.reduceat(steps.counts[order], starts) if len(starts) else np.zeros(0)

    def mean(values: Float64s | Bools) -> Float64s:
        if not len(starts):
            return values.astype(np.float64)
        sums = np.add.reduceat(values[order], starts, dtype=np.float64)
        return np.asarray(sums / counts[:, None, None])

    first, sides = order[starts], (mean(steps.colours), mean(steps.places))
    cut = mean(steps.low) > _CUT_SHARE, mean(steps.high) > _CUT_SHARE
    return Steps(steps.charts, steps.ends[first], *sides, steps.seams[first], counts, *cut, *UNKNOWN)


def with_noise(steps: Steps) -> Steps:
    """Measure how much the steps along each seam vary, and mark the seams where that is far more than usual."""
    if not len(steps.seams):
        return steps
    starts = np.flatnonzero(np.r_[True, steps.seams[1:] != steps.seams[:-1]])
    lengths = np.diff(np.r_[starts, len(steps.seams)])
    signs = np.where(steps.ends[:, 0] <= steps.ends[:, 1], 1.0, -1.0)[:, None]
    step, mean = signs * (steps.colours[:, 1] - steps.colours[:, 0]), steps.colours.mean(axis=1)
    found = np.min([_deviations(step - gain * mean, starts, lengths) for gain in _GAINS], axis=0)
    counts = np.add.reduceat(steps.counts, starts)
    usual = np.array([[weighted_median(each, counts)] for each in found])
    # Of few stretches little is known, so that they are taken for usual ones.
    whole, half = np.sqrt((lengths * np.square(found) + _PRIOR * np.square(usual)) / (lengths + _PRIOR))
    is_paint = half > _UNUSUAL * usual[1] + _ALLOWED
    noise = np.maximum(whole, _FINEST)
    return replace(steps, noise=np.repeat(noise, lengths), is_paint=np.repeat(is_paint, lengths))


def _deviations(values: Float64s, starts: Int64s, lengths: Int64s) -> Float64s:
    """Return for each run of rows two deviations, shape (2, runs), mean over channels.

    One is by the median from the median, the other of the half of the rows that agree best, whatever the rest is [1]_.

    .. [1] P. Rousseeuw, "Least median of squares regression", Journal of the American Statistical Association 79
           (1984), doi 10.1080/01621459.1984.10477105.
    """
    run = np.repeat(np.arange(len(starts)), lengths)
    half = lengths // 2
    last = np.arange(len(run)) + half[run]
    is_inside = last < (starts + lengths)[run]
    last = np.minimum(last, len(run) - 1)
    found = np.zeros((2, len(starts)))
    for column in values.T:
        ordered = column[np.lexsort((column, run))]
        distances = np.abs(column - ordered[starts + half][run])
        found[0] += distances[np.lexsort((distances, run))][starts + half]
        widths = np.where(is_inside, ordered[last] - ordered, np.inf)
        found[1] += np.minimum.reduceat(widths, starts) / 2
    return np.asarray(1.4826 * found / values.shape[1])


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
    steps = Steps(
        count, ends, np.stack(sides, axis=1), places[across], seams, np.ones(len(ends)), *cut, *UNKNOWN
    )
    return with_noise(steps), charts, places


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
