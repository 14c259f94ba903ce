"""Colours on both sides of the seams of a surface, averaged over short stretches, and the places of these in charts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.fields import BYTE_STEP
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, Indices, at_seam, lines_over_seams, refresh_halo
from beltrami_cli.surface.colour_values import limits_of
from beltrami_cli.surface.grouping import connected, edges_of

# Side of the blocks of cells whose steps are averaged, which is doubled until there are few enough stretches.
STRETCH = 4
# Stretches of all seams, at most: the time of a fit is proportional to them.
MAX_STRETCHES = 24_000
# Independent measurements in a seam, at most: its texels share errors.
PARTS = 8
# What slopes of colours are drawn to 0 by, as a share of the spread of the samples that they are known from.
RIDGE = 0.005


@dataclass(frozen=True)
class Steps:
    """Stretches of seams, K of them in the order of seams, and the colours of their two sides."""

    charts: int
    ends: Int64s  # (K, 2): the charts on the two sides, the one with the lower number first
    colours: Float64s  # (K, 2, N)
    places: Float64s  # (K, 2, 2): in the charts, about their centres, of deviation 1/2
    seams: Int64s  # (K,): the seam that a stretch is of
    counts: Float64s  # (K,): texels in it
    low: Bools  # (K, 2, N): where colours of a side were clipped at 0, so that these are upper bounds
    high: Bools  # (K, 2, N): where they were clipped at full scale

    @property
    def between(self) -> Bools:
        """Which stretches lie between different charts, shape (K,)."""
        return np.asarray(self.ends[:, 0] != self.ends[:, 1])

    def part(self, rows: Bools) -> Steps:
        """Return some of the stretches."""
        charts, *others = (getattr(self, each.name) for each in fields(self))
        return Steps(charts, *(each[rows] for each in others))

    def oriented(self) -> Steps:
        """Return the same with the sides swapped where the first chart has the higher number."""
        is_swapped = self.ends[:, 0] > self.ends[:, 1]
        sides = {name: getattr(self, name).copy() for name in ("ends", "colours", "places", "low", "high")}
        for values in sides.values():
            values[is_swapped] = values[is_swapped][:, ::-1]
        return replace(self, **sides)

    def parts(self) -> Int64s:
        """Return the part of a seam that each stretch is in, `PARTS` numbers for each seam, in equal parts."""
        lengths = np.bincount(self.seams)
        within = np.arange(len(self.seams)) - (np.cumsum(lengths) - lengths)[self.seams]
        return np.asarray(self.seams * PARTS + within * PARTS // np.maximum(lengths, PARTS)[self.seams])

    def means(self, values: Float64s | Bools, units: Int64s) -> Float64s:
        """Return the means of values of stretches over units, by texels; 0 where a unit has none."""
        texels = np.bincount(units, self.counts)
        return np.asarray(np.bincount(units, values * self.counts) / np.maximum(texels, 1))


@dataclass(frozen=True)
class ChartPlaces:
    """Where samples lie in their charts: about the centre, in units of twice the deviation."""

    centre: Float64s  # (charts, 2)
    scale: Float64s  # (charts, 2)

    @classmethod
    def of(cls, atlas: Atlas) -> ChartPlaces:
        """Measure the charts of an atlas in rows and columns."""
        blocks = large_arrays.blocks(len(atlas.owned_cells))
        cells = ((atlas.chart_of[each], positions_of(atlas, atlas.owned_cells[each])) for each in blocks)
        return cls.around(np.array(atlas.kind.shape) / 2, max(1, atlas.charts), cells)

    @classmethod
    def around(
        cls, middle: Float64s, charts: int, samples: Iterable[tuple[Indices, Float64s]]
    ) -> ChartPlaces:
        """Measure charts by the charts and positions of all samples, in units of the sample spacing."""
        sums = np.zeros((charts, 5))
        for chart_of, positions in samples:
            values = positions - middle
            columns = [None, *values.T, *np.square(values).T]
            sums += np.column_stack([np.bincount(chart_of, each, charts) for each in columns])
        means = sums[:, 1:] / np.maximum(sums[:, :1], 1)
        variance = np.maximum(means[:, 2:] - np.square(means[:, :2]), 1.0)  # of one sample at least
        return cls(means[:, :2] + middle, 2 * np.sqrt(variance))

    def at(self, positions: Float64s, charts: Indices) -> Float64s:
        """Return the places of samples in their charts, shape (K, 2)."""
        return np.asarray((positions - self.centre[charts]) / self.scale[charts])


def positions_of(atlas: Atlas, cells: Indices) -> Float64s:
    """Return the rows and columns of cells on the canvas, shape (K, 2)."""
    return np.column_stack(np.divmod(cells, atlas.kind.shape[1])).astype(np.float64)


def steps_over_seams(atlas: Atlas, planes: Float32s, places: ChartPlaces) -> Steps:
    """Measure the colours of both sides of all seams of an atlas; its halo is interpolated in place."""
    refresh_halo(planes, atlas, interpolated=True)
    inner, outer, colours, low, high = _both_sides(atlas, planes)
    halo = np.searchsorted(atlas.halo_cells, outer)
    cells = np.column_stack([inner, atlas.halo_nearest[halo]]).astype(np.int64)
    ends = atlas.chart_of[np.searchsorted(atlas.owned_cells, cells)].astype(np.int64)
    where = [places.at(positions_of(atlas, cells[:, side]), ends[:, side]) for side in (0, 1)]
    seams = atlas.halo_seams[halo].astype(np.int64)
    keys = np.column_stack([seams, ends, *np.divmod(cells[:, 0], atlas.kind.shape[1])])
    keys[:, 3:] //= STRETCH
    while len((ordered := _ordered(keys))[1]) > MAX_STRETCHES:
        keys[:, 3:] //= 2
    order, starts = ordered
    counts = np.diff(np.r_[starts, len(keys)]).astype(np.float64)

    def mean(values: Float64s | Bools) -> Float64s:
        if not len(starts):
            return values.astype(np.float64)
        sums = np.add.reduceat(values[order], starts, dtype=np.float64)
        return np.asarray(sums / counts[:, None, None])

    first, both = order[starts], mean(np.stack(where, axis=1))
    is_low, is_high = (mean(each) > 0 for each in (low, high))
    found = Steps(atlas.charts, ends[first], mean(colours), both, seams[first], counts, is_low, is_high)
    return _with_less_error(found.oriented())


def _ordered(keys: Int64s) -> tuple[Int64s, Int64s]:
    """Return the order of rows, and where in that order each different one begins."""
    order = np.lexsort(keys.T[::-1])
    is_new = np.any(np.diff(keys[order], axis=0) != 0, axis=1)
    return order, np.flatnonzero(np.r_[True, is_new][: len(order)])


def _with_less_error(steps: Steps) -> Steps:
    """Take the colours at the seam, or halfway to the means of the lines, which have less noise, but slopes."""
    exact, means = np.split(steps.colours, 2, axis=2)
    sharp, soft = (replace(steps, colours=each) for each in (exact, (exact + means) / 2))
    by_slopes = np.zeros(len(steps.seams))
    for change in np.diff(soft.colours - exact, axis=1)[:, 0].T:
        by_slopes += np.square(steps.means(change, steps.seams))[steps.seams] / exact.shape[2]
    before, after = (np.square(deviations(each, each.colours)) / PARTS for each in (sharp, soft))
    middle = [weighted_median(each, steps.counts) for each in (before, after + by_slopes)]
    return soft if middle[1] < middle[0] else sharp


def _both_sides(atlas: Atlas, planes: Float32s) -> tuple[Int64s, Int64s, Float64s, Bools, Bools]:
    """Return the cells on both sides of seams, the colours there, and which of these were clipped at 0 or 1.

    Colours are those at the seam, and the means of the lines that lead to it.
    """
    flat = planes.reshape(len(planes), -1)
    inner, outer, colours, low, high = [], [], [], [], []
    is_known, (floor, ceiling) = np.zeros(max(1, atlas.seams), bool), limits_of(planes)
    for reach in (3, 1):  # charts may be too narrow for lines of three cells
        measured = []
        for line in lines_over_seams(atlas, reach):
            seams = atlas.halo_seams[np.searchsorted(atlas.halo_cells, line[reach])]
            cells = [each[~is_known[seams]] for each in line]
            measured.append(seams)
            inner.append(cells[0])
            outer.append(cells[reach])
            halves = [[flat[:, each] for each in half] for half in (cells[:reach], cells[reach:])]
            exact, means = [at_seam(half) for half in halves], [np.mean(half, axis=0) for half in halves]
            colours.append(np.concatenate([exact, means], axis=1))
            low.append(np.stack([np.min(half, axis=0) <= floor + BYTE_STEP / 2 for half in halves]))
            high.append(np.stack([np.max(half, axis=0) >= ceiling - BYTE_STEP / 2 for half in halves]))
        is_known[np.concatenate(measured)] = True
    both, is_low, is_high = (np.concatenate(each, axis=2).transpose(2, 0, 1) for each in (colours, low, high))
    return np.concatenate(inner), np.concatenate(outer), both, is_low, is_high


def deviations(steps: Steps, sides: Float64s) -> Float64s:
    """Return for each stretch the deviation of steps between corrected sides along its seam, shape (K,)."""
    if not len(steps.seams):
        return np.zeros(0)
    lengths = np.bincount(steps.seams)
    middles = np.minimum(np.cumsum(lengths) - lengths + lengths // 2, len(steps.seams) - 1)

    def medians(values: Float64s) -> Float64s:
        # Complex numbers are sorted by their real parts first: four times as fast as `lexsort`.
        return np.asarray(np.sort(steps.seams + 1j * values).imag[middles])

    found = np.zeros(len(lengths))
    for column in (sides[:, 1] - sides[:, 0]).T:
        found += medians(np.abs(column - medians(column)[steps.seams]))
    found *= 1.4826 / sides.shape[2]  # the deviation of normal numbers by the median of their sizes
    usual = weighted_median(found[steps.seams], steps.counts)
    # Of few stretches little is known, so that they are taken for usual ones.
    whole = np.sqrt((lengths * np.square(found) + PARTS * usual**2) / (lengths + PARTS))
    return np.asarray(np.maximum(whole, BYTE_STEP)[steps.seams])


def weighted_median(values: Float64s, weights: Float64s) -> float:
    """Return the value below which half of the weight is; 0 without values."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)]) if len(order) else 0.0


def steps_over_edges(
    positions: Float64s, faces: Int32s, colours: Float64s, photographs: Int64s
) -> tuple[Steps, Indices, Float64s]:
    """Measure the steps over edges of a mesh between photographs; also return each vertex' chart and place in it.

    A chart is what edges join of one photograph.
    """
    edges = np.unique(np.sort(edges_of(faces), axis=1), axis=0).astype(np.int64)
    inside = edges[photographs[edges[:, 0]] == photographs[edges[:, 1]]]
    charts = connected(len(positions), inside)
    count = int(charts.max(initial=-1)) + 1
    # Places on the plane of the two directions in which all is longest, in mean lengths of edges.
    spacing = float(np.linalg.norm(np.diff(positions[edges], axis=1), axis=2).mean()) or 1.0
    centred = (positions - positions.mean(axis=0)) / spacing
    flat = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -2:]
    places = ChartPlaces.around(np.zeros(2), count, [(charts, flat)]).at(flat, charts)
    across = edges[charts[edges[:, 0]] != charts[edges[:, 1]]]
    ends = charts[across].astype(np.int64)
    seams = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    order = np.argsort(seams, kind="stable")
    across, ends, seams = across[order], ends[order], seams[order]
    slopes = _slopes(positions, colours, inside)
    half = (positions[across[:, 1]] - positions[across[:, 0]]) / 2
    sides = [
        colours[across[:, side]] + sign * np.einsum("kx,kxn->kn", half, slopes[across[:, side]])
        for side, sign in ((0, 1.0), (1, -1.0))
    ]
    floor, ceiling = limits_of(colours)
    low, high = colours[across] <= floor + BYTE_STEP / 2, colours[across] >= ceiling - BYTE_STEP / 2
    both, counts = np.stack(sides, axis=1), np.ones(len(ends))
    return Steps(count, ends, both, places[across], seams, counts, low, high).oriented(), charts, places


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
    spreads += np.where(size > 0, RIDGE * size, 1.0)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(spreads, products))
