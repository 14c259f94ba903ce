"""Colours on both sides of seams, averaged over short stretches, and the positions of these in their charts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.quantities import BYTE_STEP
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, at_seam, lines_over_seams, refresh_halo
from beltrami_cli.surface.colour_values import limits_of
from beltrami_cli.surface.geometry import edges_of
from beltrami_cli.surface.grouping import connected

# Side of the blocks of cells over which steps are averaged, doubled until there are few enough stretches. With 2, 4 and
# 8 the error of exposed samples (tests/levelling/exposure_scene.py) falls by 29.0, 29.2 and 28.9 dB.
STRETCH = 4
# Maximum number of stretches of all seams, to which the time of a fit is proportional.
MAX_STRETCHES = 24_000
# Maximum number of independent measurements in a seam: its texels share errors.
PARTS = 8
# Prior precision of slopes at 0, as a share of the spread of the samples from which they are estimated.
RIDGE = 0.005


@dataclass(frozen=True)
class Steps:
    """K stretches of seams, sorted by seam, with the colours of their two sides."""

    fixed: Bools  # (charts,): whether a chart keeps its exposure
    ends: Int64s  # (K, 2): the charts on the two sides, the one with the lower number first
    colours: Float64s  # (K, 2, N)
    places: Float64s  # (K, 2, 2): position in both charts, about the centre, of deviation 1/2
    seams: Int64s  # (K,): the seam of each stretch
    counts: Float64s  # (K,): number of texels
    low: Bools  # (K, 2, N): colours clipped at 0, which are upper bounds
    high: Bools  # (K, 2, N): colours clipped at full scale, which are lower bounds

    @property
    def charts(self) -> int:
        """Number of charts."""
        return len(self.fixed)

    @property
    def between(self) -> Bools:
        """Which stretches are between different charts, shape (K,)."""
        return np.asarray(self.ends[:, 0] != self.ends[:, 1])

    def select(self, rows: Bools) -> Steps:
        fixed, *others = (getattr(self, each.name) for each in fields(self))
        return Steps(fixed, *(each[rows] for each in others))

    def oriented(self) -> Steps:
        """Swap the sides of stretches whose first chart has the higher number."""
        is_swapped = self.ends[:, 0] > self.ends[:, 1]
        sides = {name: getattr(self, name).copy() for name in ("ends", "colours", "places", "low", "high")}
        for values in sides.values():
            values[is_swapped] = values[is_swapped][:, ::-1]
        return replace(self, **sides)

    def parts(self) -> Int64s:
        """Return the part of each stretch, among `PARTS` equal parts of its seam."""
        lengths = np.bincount(self.seams)
        within = np.arange(len(self.seams)) - (np.cumsum(lengths) - lengths)[self.seams]
        return np.asarray(self.seams * PARTS + within * PARTS // np.maximum(lengths, PARTS)[self.seams])

    def means(self, values: Float64s | Bools, units: Int64s) -> Float64s:
        """Return the means of values over units of stretches, weighted by texels; 0 for empty units."""
        texels = np.bincount(units, self.counts)
        return np.asarray(np.bincount(units, values * self.counts) / np.maximum(texels, 1))


@dataclass(frozen=True)
class ChartPlaces:
    """Positions of samples in their charts: about the centre, in units of twice the deviation."""

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
        """Measure charts by the positions of their samples, in units of the sample spacing."""
        sums = np.zeros((charts, 5))
        for chart_of, positions in samples:
            values = positions - middle
            columns = [None, *values.T, *np.square(values).T]
            sums += np.column_stack([np.bincount(chart_of, each, charts) for each in columns])
        means = sums[:, 1:] / np.maximum(sums[:, :1], 1)
        variance = np.maximum(means[:, 2:] - np.square(means[:, :2]), 1.0)  # at least that of one sample
        return cls(means[:, :2] + middle, 2 * np.sqrt(variance))

    def at(self, positions: Float64s, charts: Indices) -> Float64s:
        """Return the positions of samples within their charts, shape (K, 2)."""
        return np.asarray((positions - self.centre[charts]) / self.scale[charts])


def positions_of(atlas: Atlas, cells: Indices) -> Float64s:
    """Return the rows and columns of cells on the canvas, shape (K, 2)."""
    return np.column_stack(np.divmod(cells, atlas.kind.shape[1])).astype(np.float64)


def steps_over_seams(atlas: Atlas, planes: Float32s, places: ChartPlaces, fixed: Bools) -> Steps:
    """Measure the colours of both sides of all seams of an atlas; its halo is interpolated in place."""
    refresh_halo(planes, atlas, interpolated=True)
    inner, outer, colours, low, high = _both_sides(atlas, planes)
    halo = np.searchsorted(atlas.halo.cells, outer)
    cells = np.column_stack([inner, atlas.halo.nearest[halo]]).astype(np.int64)
    ends = atlas.chart_of[np.searchsorted(atlas.owned_cells, cells)].astype(np.int64)
    where = [places.at(positions_of(atlas, cells[:, side]), ends[:, side]) for side in (0, 1)]
    seams = atlas.halo.seams[halo].astype(np.int64)
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
    exact, of_lines = np.split(mean(colours), 2, axis=2)
    is_low, is_high = (mean(each) > 0 for each in (low, high))
    sharp = Steps(fixed, ends[first], exact, both, seams[first], counts, is_low, is_high)
    soft = replace(sharp, colours=(exact + of_lines) / 2)
    return _less_noisy(sharp.oriented(), soft.oriented())


def _ordered(keys: Int64s) -> tuple[Int64s, Int64s]:
    """Return the sort order of rows, and the index in it where each distinct row begins."""
    order = np.lexsort(keys.T[::-1])
    is_new = np.any(np.diff(keys[order], axis=0) != 0, axis=1)
    return order, np.flatnonzero(np.r_[True, is_new][: len(order)])


def _less_noisy(sharp: Steps, soft: Steps) -> Steps:
    """Choose between the steps at the seam and those of means, which have less noise but are biased by slopes."""
    by_slopes = np.zeros(len(sharp.seams))
    for change in np.diff(soft.colours - sharp.colours, axis=1)[:, 0].T:
        by_slopes += np.square(sharp.means(change, sharp.seams))[sharp.seams] / sharp.colours.shape[2]
    before, after = (np.square(deviations(each, each.colours)) / PARTS for each in (sharp, soft))
    middle = [weighted_median(each, sharp.counts) for each in (before, after + by_slopes)]
    return soft if middle[1] < middle[0] else sharp


def _both_sides(atlas: Atlas, planes: Float32s) -> tuple[Int64s, Int64s, Float64s, Bools, Bools]:
    """Return the cells on both sides of seams, the colours there, and which of these are clipped at 0 or 1.

    The colours of N channels are those at the seam, followed by the means of the lines that lead to it.
    """
    flat = planes.reshape(len(planes), -1)
    inner, outer, colours, low, high = [], [], [], [], []
    is_known, (floor, ceiling) = np.zeros(max(1, atlas.seams), bool), limits_of(planes)
    for reach in (3, 1):  # one cell if charts are too narrow for three
        measured = []
        for line in lines_over_seams(atlas, reach):
            seams = atlas.halo.seams[np.searchsorted(atlas.halo.cells, line[reach])]
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
    """Return the deviation of corrected steps along the seam of each stretch, shape (K,)."""
    if not len(steps.seams):
        return np.zeros(0)
    lengths = np.bincount(steps.seams)
    middles = np.minimum(np.cumsum(lengths) - lengths + lengths // 2, len(steps.seams) - 1)

    def medians(values: Float64s) -> Float64s:
        # `sort` orders complex numbers by their real part first: four times as fast as `lexsort`.
        return np.asarray(np.sort(steps.seams + 1j * values).imag[middles])

    of_seams = np.zeros(len(lengths))
    for column in (sides[:, 1] - sides[:, 0]).T:
        of_seams += medians(np.abs(column - medians(column)[steps.seams]))
    of_seams *= 1.4826 / sides.shape[2]  # standard deviation of a normal variable from its median magnitude
    usual = weighted_median(of_seams[steps.seams], steps.counts)
    # A seam of few stretches gets the usual deviation.
    whole = np.sqrt((lengths * np.square(of_seams) + PARTS * usual**2) / (lengths + PARTS))
    return np.asarray(np.maximum(whole, BYTE_STEP)[steps.seams])


def weighted_median(values: Float64s, weights: Float64s) -> float:
    """Return the value below which half of the weight is; 0 without values."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)]) if len(order) else 0.0


def steps_over_edges(
    positions: Float64s, faces: Int32s, colours: Float64s, photographs: Int64s
) -> tuple[Steps, Indices, Float64s]:
    """Measure the steps over mesh edges between photographs; return also the chart and position of vertices.

    A chart is a connected part of one photograph.
    """
    edges = np.unique(np.sort(edges_of(faces), axis=1), axis=0).astype(np.int64)
    inside = edges[photographs[edges[:, 0]] == photographs[edges[:, 1]]]
    charts = connected(len(positions), inside)
    places = _places_on_plane(positions, edges, charts)
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
    steps = Steps(
        fixed=np.zeros(int(charts.max(initial=-1)) + 1, bool),
        ends=ends,
        colours=np.stack(sides, axis=1),
        places=places[across],
        seams=seams,
        counts=np.ones(len(ends)),
        low=low,
        high=high,
    )
    return steps.oriented(), charts, places


def _places_on_plane(positions: Float64s, edges: Int64s, charts: Indices) -> Float64s:
    """Return the places of vertices in their charts, on the plane of the two principal directions."""
    edge_length = float(np.linalg.norm(np.diff(positions[edges], axis=1), axis=2).mean()) or 1.0
    centred = (positions - positions.mean(axis=0)) / edge_length
    flat = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -2:]
    count = int(charts.max(initial=-1)) + 1
    return ChartPlaces.around(np.zeros(2), count, [(charts, flat)]).at(flat, charts)


def _slopes(positions: Float64s, colours: Float64s, edges: Int64s) -> Float64s:
    """Return the slopes of colours at each vertex, shape (S, 3, N), by least squares over its edges."""
    directions = positions[edges[:, 1]] - positions[edges[:, 0]]
    rises = colours[edges[:, 1]] - colours[edges[:, 0]]
    spreads = np.zeros((len(positions), 3, 3))
    products = np.zeros((len(positions), 3, colours.shape[1]))
    for side in (0, 1):  # reversed edges have the same products
        np.add.at(spreads, edges[:, side], directions[:, :, None] * directions[:, None, :])
        np.add.at(products, edges[:, side], directions[:, :, None] * rises[:, None, :])
    size = np.trace(spreads, axis1=1, axis2=2)
    spreads += np.where(size > 0, RIDGE * size, 1.0)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(spreads, products))
