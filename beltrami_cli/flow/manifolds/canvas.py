"""The canvas of an atlas: filling, seams with jumps in colour, patches, and coarse levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s, Uint8s
from beltrami_cli.flow.chunks import Chunking, Figures, Rectangle, Resources, chunks_of_canvas, grown
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Mixing, Stack
from beltrami_cli.flow.manifolds.grid_gaussian import gaussian_taps, guide_radius
from beltrami_cli.flow.manifolds.grid_geometry import colours_at
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.noise.drawing import mixed_signs
from beltrami_cli.flow.noise.grid_squares import Grid
from beltrami_cli.flow.noise.reading import read_noise
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas, refresh_halo

# The paper's scheme searches the support of an obtuse quadrant up to this many cells away.
FURTHEST_SUPPORT = 10

# A jump counts if it is this many standard errors of the mean over the seam ...
_ERRORS = 4.0
# ... and this share of the noise: below, averaging over the seam still removes more noise than it adds bias ...
_OF_NOISE = 0.3
# ... and more than JPEG blocks and rounding leave between two charts of one continuous image.
_MIN_JUMP = 4 / 255
# Minimum number of steps over a seam to estimate their energy.
_MIN_STEPS = 8

# Seed of random means; an arbitrary number.
_SEED = 21


def on_canvas(atlas: Atlas, colours: Float32s) -> Float32s:
    """Put the colours of the owned cells, shape (T, N), on the canvas; see `fill_canvas`."""
    return fill_canvas(atlas, colours.shape[1], colours.__getitem__)


def fill_canvas(atlas: Atlas, channels: int, colours_of: Callable[[slice], Float32s]) -> Float32s:
    """Return planes, shape (N, R, C), with colours in owned and halo cells, and 0 in empty cells."""
    planes = large_arrays.zeros((channels, *atlas.kind.shape), np.float32)
    for block in large_arrays.blocks(len(atlas.owned_cells), large_arrays.CACHED):
        for plane, colours in zip(planes.reshape(channels, -1), colours_of(block).T, strict=True):
            plane[atlas.owned_cells[block]] = colours
    refresh_halo(planes, atlas)
    return planes


def canvas_colours(atlas: Atlas, planes: Float32s) -> NewColours:
    """Return the colours of owned cells, read from the canvas lazily, and those of the gutter."""
    refresh_halo(planes, atlas, interpolated=True)
    flat, cells, gutter = planes.reshape(len(planes), -1), atlas.owned_cells, atlas.gutter_cells
    beyond = np.zeros((len(gutter), len(flat)), np.float32)
    for block in large_arrays.blocks(len(gutter), large_arrays.SCATTERED):
        beyond[block] = flat[:, gutter[block]].T
    return NewColours(
        lambda block, inside: colours_at(planes, cells[block][inside]),
        atlas.owned_texels,
        atlas.gutter_texels,
        beyond,
    )


def canvas_margin(parameters: KernelParameters) -> int:
    """Return the number of cells beyond a chart that kernels and patches read."""
    from beltrami_cli._native import PATCH_REACH

    blurred = guide_radius(parameters.metric_scale) if parameters.metric_steps else 0
    return max(parameters.window // 2 + blurred, PATCH_REACH if parameters.takes_patches else 0)


def kernel_margin(parameters: KernelParameters) -> int:
    """Return the number of cells around a cell that influence one iteration."""
    support = FURTHEST_SUPPORT if parameters.scheme == "metric" else 0
    blurred = guide_radius(parameters.metric_scale) if parameters.metric_steps else 0
    return parameters.window // 2 + 1 + support + blurred


def find_colour_jumps(atlas: Atlas, planes: Float32s, sigma: Float64s) -> Bools:
    """Return whether the sides of each seam differ by more than noise, shape (S,)."""
    different = np.zeros(max(1, atlas.seams), bool)
    seam, steps, along = _steps_over_seams(atlas, planes)
    if not len(seam):
        return different
    order = np.argsort(seam, kind="stable")
    starts = np.flatnonzero(np.r_[True, seam[order][1:] != seam[order][:-1]])
    noise = float(np.sqrt(np.mean(np.square(sigma))))
    for first, last in zip(starts, np.r_[starts[1:], len(seam)], strict=True):
        members = order[first:last]
        jump = np.abs(np.median(steps[members], axis=0)).max()
        # A step between two noisy samples has the deviation sqrt(2) sigma. The error of a median is 1.25 times that of
        # a mean.
        error = 1.25 * np.sqrt(2) * noise / np.sqrt(len(members))
        shifted = jump > max(_ERRORS * error, _OF_NOISE * noise, _MIN_JUMP)
        different[seam[members[0]]] = shifted or _is_patterned(steps[members], along[members], noise)
    return different


def _steps_over_seams(atlas: Atlas, planes: Float32s) -> tuple[Int32s, Float32s, Float32s]:
    """Return the seam of each halo cell next to an owned cell, the step to it, and the step before."""
    rows, columns = atlas.kind.shape
    flat_kind, flat = atlas.kind.reshape(-1), planes.reshape(len(planes), -1)
    seams: list[Int32s] = []
    over: list[Float32s] = []
    before: list[Float32s] = []
    of_seams = np.flatnonzero(atlas.halo_seams >= 0)
    for block in large_arrays.blocks(len(of_seams), large_arrays.SCATTERED):
        cells, halo_seams = atlas.halo_cells[of_seams[block]], atlas.halo_seams[of_seams[block]]
        for step in (1, -1, columns, -columns):
            inner, second = cells - step, cells - 2 * step
            valid = (second >= 0) & (second < rows * columns) & (inner >= 0) & (inner < rows * columns)
            valid[valid] &= (flat_kind[inner[valid]] == OWNED) & (flat_kind[second[valid]] == OWNED)
            seams.append(halo_seams[valid])
            over.append((flat[:, cells[valid]] - flat[:, inner[valid]]).T)
            before.append((flat[:, inner[valid]] - flat[:, second[valid]]).T)
    if not seams:
        nothing = np.zeros((0, len(planes)), np.float32)
        return np.zeros(0, np.int32), nothing, nothing
    return np.concatenate(seams), np.concatenate(over), np.concatenate(before)


def _is_patterned(steps: Float32s, nearby: Float32s, noise: float) -> bool:
    """Detect a jump that changes its sign along the seam: steps across it have more energy than steps next to it.

    Neighbours may share noise, as in JPEG pictures, but not across a seam, which adds to the energy there.
    """
    if len(steps) < _MIN_STEPS:
        return False
    across, along = np.square(steps).mean(axis=1), np.square(nearby).mean(axis=1)
    error = float((across - along).std()) / np.sqrt(len(steps))
    excess = across.mean() - max(along.mean(), 2 * noise**2)
    return bool(excess > max(_ERRORS * error, (_OF_NOISE * noise) ** 2 + _MIN_JUMP**2))


def halo_beyond(atlas: Atlas, different: Bools) -> Bools:
    """Return which halo cells, shape (H,), lie beyond the seams marked in `different`, shape (S,)."""
    # Near a corner of several charts a cell may be reached over two seams; either may be marked.
    seams = atlas.halo_seams
    beyond = (seams >= 0) & different[np.maximum(seams, 0)]
    if not beyond.any():
        return beyond
    reached = _charts_at(atlas, atlas.halo_nearest)
    sides = _sides_of_seams(atlas, reached)
    jumps = {tuple(pair) for seam, pair in enumerate(np.sort(sides, axis=1).tolist()) if different[seam]}
    # Cells of a third chart, grouped by chart and seam.
    third = (seams >= 0) & ~beyond & (reached[:, None] != sides[seams]).all(axis=1)
    for seam, chart in {*zip(seams[third].tolist(), reached[third].tolist(), strict=True)}:
        if any((min(chart, side), max(chart, side)) in jumps for side in sides[seam].tolist()):
            beyond |= third & (seams == seam) & (reached == chart)
    return beyond


def _charts_at(atlas: Atlas, cells: Indices) -> Int32s:
    """Return the charts of cells; -1 for cells that are not owned."""
    charts = np.full(len(cells), -1, np.int32)
    for block in large_arrays.blocks(len(cells) if len(atlas.owned_cells) else 0, large_arrays.SCATTERED):
        wanted = cells[block]
        rank = np.minimum(np.searchsorted(atlas.owned_cells, wanted), len(atlas.owned_cells) - 1)
        owned = atlas.owned_cells[rank] == wanted
        charts[block][owned] = atlas.chart_of[rank[owned]]
    return charts


def _sides_of_seams(atlas: Atlas, reached: Int32s) -> Int32s:
    """Return the two charts of each seam, shape (S, 2): of an owned cell and of the halo cell next to it."""
    kind, columns = atlas.kind.reshape(-1), atlas.kind.shape[1]
    of_seams = np.flatnonzero(atlas.halo_seams >= 0)
    cells, seams = atlas.halo_cells[of_seams], atlas.halo_seams[of_seams]
    inner, halo = np.full((2, max(1, atlas.seams)), -1, cells.dtype)
    for step in (1, -1, columns, -columns):
        found = kind.take(cells - step, mode="clip") == OWNED  # the first and the last cell are in the margin
        inner[seams[found]], halo[seams[found]] = cells[found] - step, of_seams[found]
    known = np.flatnonzero(halo >= 0)
    sides = np.full((len(halo), 2), -1, np.int32)
    sides[known] = np.column_stack([_charts_at(atlas, inner[known]), reached[halo[known]]])
    return sides


def end_at_seams_in_place(planes: Float32s, atlas: Atlas, threads: int) -> None:
    """Extend a guide as a constant over the seams whose sides differ."""
    from beltrami_cli._native import nearest_marked

    sigma = read_noise(planes, Grid(atlas.kind == OWNED), varies=False).sigma
    beyond = atlas.halo_cells[halo_beyond(atlas, find_colour_jumps(atlas, planes, sigma))]
    if len(beyond):
        wanted = np.zeros(atlas.kind.shape, bool)
        wanted.reshape(-1)[beyond] = True
        cells, nearest = nearest_marked(atlas.kind == OWNED, wanted, max(atlas.kind.shape), threads)
        flat = planes.reshape(len(planes), -1)
        flat[:, cells] = flat[:, nearest]


def collaborate_on_canvas(
    kind: Uint8s,
    stacks: Sequence[Stack],
    mixing: Mixing,
    threads: int,
    progress: Callable[[int], None] | None = None,
    *,
    replaces_pilot: bool = False,
    chunking: Chunking | None = None,
) -> Float32s:
    """Estimate the owned cells from similar patches.

    `stacks`: the noisy colours, the pilot on which patches are compared, and, if the noise varies, its variance
    relative to the mean.
    """
    from beltrami_cli._native import PATCH_TILE_MARGIN, PATCH_TILE_SIDE

    noisy, pilot = stacks[:2]
    if chunking is None:
        taken = pilot if replaces_pilot else None
        return _patches_on((kind, ...), stacks, threads, mixing, progress, taken)[0][0]
    estimates: Float32s = large_arrays.empty(noisy.shape, np.float32)
    # Groups start tile by tile. The order in which tiles add to a cell has a period of two tiles.
    before, after = 2 * PATCH_TILE_SIDE, PATCH_TILE_SIDE + PATCH_TILE_MARGIN
    cut, operation = partial(_part_for_patches, kind), partial(_patches_on, mixing=mixing)
    chunks = chunks_of_canvas(cut, kind == OWNED, chunking.count, before, before, after)
    chunking.apply(chunks, operation, stacks, [estimates], progress, size=kind.size, threads=threads)
    return estimates


def _part_for_patches(kind: Uint8s, around: Rectangle, core: Rectangle) -> tuple[Uint8s, Rectangle]:
    """Return the kinds of the cells of a part; groups start only near `core`, the rectangle that is estimated."""
    from beltrami_cli._native import PATCH_TILE_SIDE

    part: Uint8s = kind[around].copy()
    # The groups of adjacent tiles reach the rectangle; cells beyond these only supply candidates.
    inside = np.zeros(part.shape, bool)
    inside[grown(core, PATCH_TILE_SIDE, PATCH_TILE_SIDE, part.shape)] = True
    part[(part == OWNED) & ~inside] = HALO
    return part, core


def _patches_on(
    part: tuple[Uint8s, Any],
    stacks: Sequence[Float32s],
    threads: int,
    mixing: Mixing,
    progress: Callable[[int], None] | None = None,
    estimates: Float32s | None = None,
) -> tuple[list[Float32s], Figures]:
    from beltrami_cli._native import collaborate_on_grid

    (kind, wanted), (noisy, pilot, *relative) = part, stacks
    if estimates is None:
        estimates = large_arrays.empty(noisy.shape, np.float32)

    def report(done: int) -> None:
        large_arrays.release_pages()
        if progress is not None:
            progress(done)

    variances = relative[0][0] if relative else None
    collaborate_on_grid(
        kind, noisy, pilot, mixing.parts, variances, mixing.has_pilot, estimates, threads, report
    )
    return [estimates[wanted]], (0, 0)


def squares_for(
    atlas: Atlas,
    parameters: KernelParameters,
    most: int,
    relative: Float32s | None,
    resources: Resources,
    tick: Callable[[], None] | None = None,
) -> list[Squares]:
    """Return up to `most` levels of squares, fine to coarse, as long as no square has cells of two charts."""
    one_chart = atlas.chart_of.max(initial=0) == 0
    apart = max(atlas.kind.shape) if one_chart else 2 * canvas_margin(parameters)
    sides = (2**level for level in range(1, most + 1))
    return [
        Squares(atlas, side, parameters.thread_count, relative, resources, tick)
        for side in sides
        if side <= apart
    ]


class Squares(CoarseLevel):
    """Means over squares of cells of a canvas: of the owned cells in each, else of its halo cells."""

    axis: ClassVar[int] = 0

    def __init__(
        self,
        atlas: Atlas,
        side: int,
        threads: int,
        relative: Float32s | None,
        resources: Resources,
        tick: Callable[[], None] | None = None,
        *,
        width: float = 3.0,
    ) -> None:
        self._atlas, self.side, self._threads, self.width = atlas, side, threads, width
        self._chunking = resources.chunking
        self._report = None if tick is None else lambda _: tick()
        kinds, counts = sort_squares(atlas.kind, side)
        self.kinds, self._counts = large_arrays.kept(kinds), large_arrays.kept(counts)
        self.noise = 1 / side**2
        self._differing = None if relative is None else self.means(relative)[0]
        ones = np.broadcast_to(np.float32(1), self.kinds.shape)
        self.relative = ones if self._differing is None else self._differing

    def means(self, stack: Float32s) -> Float32s:
        """Return the means of planes, shape (N, R, C); 0 in empty squares."""
        means: Float32s = large_arrays.empty((len(stack), *self.kinds.shape), np.float32)
        for cells in self._blocks():
            for plane, own in zip(stack[:, None], means, strict=True):
                rows, part = self.means_of_rows(plane[:, cells], cells)
                own[rows] = part[0]
        return means

    def means_of_rows(self, planes: Float32s, rows: slice) -> tuple[slice, Float32s]:
        from beltrami_cli._native import means_of_squares

        squares = slice(rows.start // self.side, -(-rows.stop // self.side))
        kind, kinds = self._atlas.kind[rows], self.kinds[squares]
        return squares, means_of_squares(kind, kinds, planes, self.side, self._threads)

    def _blocks(self) -> Iterator[slice]:
        """Yield slices of rows of cells, in whole squares."""
        rows, columns = self._atlas.kind.shape
        return large_arrays.blocks(rows, max(1, large_arrays.BLOCK // (self.side * columns)) * self.side)

    def collaborate(self, noisy: Stack, pilot: Stack, mixing: Mixing, *, shared: bool = False) -> Stack:
        """Estimate means from patches; `shared` noise does not fall with the number of cells in a square."""
        stacks = [noisy, pilot]
        if not shared:
            fewer = np.maximum(self._counts, 1) * np.float32(self.noise)
            stacks.append((self.relative / fewer)[None])
        elif self._differing is not None:
            stacks.append(self._differing[None])
        return collaborate_on_canvas(
            self.kinds, stacks, mixing, self._threads, self._report, chunking=self._chunking
        )

    def probe(self, means: Stack, noise: Float64s) -> Stack:
        return mixed_signs(noise, means.shape[1:], np.random.default_rng(_SEED))

    def enlarged(self, planes: Float32s, rows: slice) -> Float32s:
        """Interpolate planes bilinearly between owned squares, at the owned cells of some rows; 0 in other cells."""
        from beltrami_cli._native import add_enlarged

        # Include the squares above and below for interpolation.
        around = slice(max(0, rows.start // self.side - 1), -(-rows.stop // self.side) + 1)
        kind = self._atlas.kind[around.start * self.side : around.stop * self.side]
        cells = np.zeros((len(planes), *kind.shape), np.float32)
        add_enlarged(kind, self.kinds[around], planes[:, around], cells, self.side, self._threads)
        first = around.start * self.side
        return cells[:, rows.start - first : rows.stop - first]

    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        for rows in self._blocks():
            for plane, change in zip(stack, changes[:, None], strict=True):
                plane[rows] += self.enlarged(change, rows)[0]
        refresh_halo(stack, self._atlas)

    def planes(self, count: int) -> Float32s:
        planes: Float32s = large_arrays.zeros((count, *self.kinds.shape), np.float32)
        return planes

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(
            np.sum(planes * self._counts, axis=(1, 2), dtype=np.float64, where=self.kinds == OWNED)
        )

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over adjacent owned squares."""
        from beltrami_cli._native import convolve

        return convolve(planes * (self.kinds == OWNED), gaussian_taps(self.width), self._threads)


def sort_squares(kind: Uint8s, side: int) -> tuple[Uint8s, Float32s]:
    """Return the kind of each square, OWNED if any cell is owned, and its number of cells of that kind."""
    kinds = np.empty((-(-len(kind) // side), -(-kind.shape[1] // side)), np.uint8)
    counts = np.empty(kinds.shape, np.float32)
    for rows in large_arrays.blocks(len(kinds), max(1, large_arrays.BLOCK // (side * kind.shape[1]))):
        cells = kind[rows.start * side : rows.stop * side]
        owned, halo = (
            _sums_of_runs(_sums_of_runs(cells == wanted, side).T, side).T for wanted in (OWNED, HALO)
        )
        kinds[rows] = np.where(owned > 0, OWNED, np.where(halo > 0, HALO, EMPTY))
        counts[rows] = np.where(owned > 0, owned, halo)
    return kinds, counts


def _sums_of_runs(rows: Bools | Int32s, length: int) -> Int32s:
    sums = np.zeros((-(-len(rows) // length), rows.shape[1]), np.int32)
    for first in range(length):
        part = rows[first::length]
        sums[: len(part)] += part
    return sums
