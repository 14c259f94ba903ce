"""The image manifold of colours on a regular grid: the canvas of a texture atlas, or one image.

Canvases are averaged in chunks, if they are cut (`Manifold.average_in_place`). Each chunk, or else the whole canvas, is
averaged in place, row block by row block (`_average_block`), which needs little more memory than the colours.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from beltrami_cli._native import SWEEP_TILE_ROWS
from beltrami_cli.arrays import Array, Bools, Float32s, Int64s
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunk, KernelCounts, Resources
from beltrami_cli.flow.cuts import Rectangle, chunks_of_canvas
from beltrami_cli.flow.manifolds.geometry import Gaussian, Stack
from beltrami_cli.flow.manifolds.grid.canvas import canvas_colours, on_canvas
from beltrami_cli.flow.manifolds.grid.gaussian import GridGaussian, gaussian_reach
from beltrami_cli.flow.manifolds.grid.geometry import CellIndex, GridGeometry, pick
from beltrami_cli.flow.manifolds.grid.kernel import average_planes, distances_in_window
from beltrami_cli.flow.manifolds.grid.levels import Squares, largest_side
from beltrami_cli.flow.manifolds.grid.margins import kernel_margin
from beltrami_cli.flow.manifolds.grid.patches import collaborate_on_canvas
from beltrami_cli.flow.manifolds.grid.perturbations import draw_perturbations
from beltrami_cli.flow.manifolds.grid.seams import end_at_seams_in_place
from beltrami_cli.flow.manifolds.grid.trial import choose_blocks, with_halo
from beltrami_cli.flow.manifolds.guides import Guide, GuideStack
from beltrami_cli.flow.manifolds.iteration import (
    Averaged,
    Metric,
    SampledKernel,
    Step,
    at_step,
    kernel_values,
)
from beltrami_cli.flow.manifolds.manifold import Manifold, PartAndCore, SampleTrial
from beltrami_cli.flow.manifolds.metric_channels import gaussian_for, joined_channels
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.manifolds.search_range import BUDGET_ON_GRIDS, ON_GRIDS, RULE_ON_GRIDS, wanted_probes
from beltrami_cli.flow.manifolds.stabilised_colours import StabilisedColours
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.parameters import KernelParameters, Space
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED, Atlas, refresh_halo

# Cells of a row block for each thread, and the number of threads for which it has cells at least. A cell takes some 90
# bytes.
_CELLS_PER_THREAD, _MIN_THREADS = 1 << 16, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class ColouredCanvas:
    """The canvas of an atlas, the input's colours of its T owned cells, and the guides of their smoothing."""

    atlas: Atlas
    channels: int
    colours_of: Callable[[slice], Float32s]  # of a block of owned cells, shape (K, channels)
    parameters: KernelParameters
    deviations: Float32s | None = None  # shape (T, K): given standard deviations of the noise
    light: Space | None = None  # space of colours that stand for light; None: they do not
    guides: Sequence[Guide] = ()
    metric_channels: Sequence[int] | None = None
    stop_at_holes: bool = False
    unit: float | None = None  # of length, in sample spacings; None: by the parameters
    resources: Resources = IN_ONE_PIECE


@dataclass(frozen=True, kw_only=True, eq=False)
class CanvasColours(StabilisedColours):
    """Stabilised colours on a canvas that ends at the seams over which colours jump."""

    atlas: Atlas
    jumps: int  # number of such seams


def grid_manifold(canvas: ColouredCanvas, colours: CanvasColours) -> GridManifold:
    """Make the image manifold of colours of a canvas."""
    parameters = canvas.parameters
    grid = GridGeometry.of(colours.atlas, parameters, stop_at_holes=canvas.stop_at_holes)
    unit = grid.unit(parameters) if canvas.unit is None else canvas.unit
    return GridManifold(
        geometry=grid, colours=colours.stack, noise=colours.noise, parameters=parameters, unit=unit,
        metric_channels=slice(None) if canvas.metric_channels is None else list(canvas.metric_channels),
        guides=tuple(GuideStack.of(guide, _guide_on_canvas(guide, grid), grid, unit) for guide in canvas.guides),
        jumps=colours.jumps, outliers=colours.outliers, resources=canvas.resources,
    )  # fmt: skip


def _guide_on_canvas(guide: Guide, grid: GridGeometry) -> Stack:
    planes = on_canvas(grid.atlas, guide.values)
    if guide.in_chart_frame:
        end_at_seams_in_place(planes, grid.atlas, grid.threads)
    return planes


@dataclass(frozen=True, kw_only=True, eq=False)
class GridManifold(Manifold):
    """The image manifold of an atlas."""

    plain_levels = 3, 2
    search_range, rule = ON_GRIDS, RULE_ON_GRIDS

    geometry: GridGeometry
    jumps: int = 0  # number of seams over which colours jump, where kernels stop

    def measure(self, colours: Stack, step: Step, gaussian: Gaussian | None = None) -> Metric:
        """Prepare the metric, eq. (1), which averaging then induces row block by row block."""
        del colours
        return Metric(step, gaussian_for(self, step, gaussian))

    def average_core_in_place(
        self, stacks: list[Stack], step: Step, core: Rectangle
    ) -> tuple[list[Stack], KernelCounts]:
        done = self.average_in_place(stacks, self.measure(stacks[0], step))
        return [stack[core] for stack in done.stacks], KernelCounts(done.samples)

    def average(
        self, stacks: list[Stack], metric: Metric, progress: Callable[[int], None] | None = None
    ) -> Averaged:
        planes, samples = self._apply_kernel(stacks, metric, progress)
        refresh_halo(planes, self.geometry.atlas)
        return Averaged(_split(planes, stacks), samples)

    def average_in_place(
        self, stacks: list[Stack], metric: Metric, progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average stacks in chunks or row block by row block, which replace the rows of the stacks."""
        atlas, margin = self.geometry.atlas, kernel_margin(self.parameters)
        cells = _CELLS_PER_THREAD * max(_MIN_THREADS, self.parameters.thread_count)
        blocks = row_blocks(atlas.kind.shape, margin, cells)
        if self.chunking is not None or len(blocks) < 2:
            return super().average_in_place(stacks, metric, progress)
        samples, averaged = 0, deque[tuple[slice, Float32s]]()
        for block in blocks:
            large_arrays.release_pages()
            planes, counted = self._average_block(stacks, metric, block, margin, progress)
            averaged.append((block, planes))
            samples += counted
            # The next block reads the rows of this one before they are replaced, but none above.
            if len(averaged) > 1:
                _write_rows(stacks, *averaged.popleft())
        _write_rows(stacks, *averaged.popleft())
        large_arrays.release_pages()
        for stack in stacks:
            refresh_halo(stack, atlas)
        return Averaged(stacks, samples)

    def _average_block(
        self, stacks: list[Stack], metric: Metric, block: slice, margin: int, progress: Callable[[int], None] | None
    ) -> tuple[Float32s, int]:  # fmt: skip
        """Average some rows of stacks, which are not changed."""
        rows, columns = self.geometry.atlas.kind.shape
        around = slice(max(0, block.start - margin), min(rows, block.stop + margin))
        core = slice(block.start - around.start, block.stop - around.start)
        share = (block.stop - block.start) / (around.stop - around.start)
        part, _ = self._cut_chunk((..., around, slice(0, columns)), (..., core, slice(None)))
        gaussian = cast("GridGaussian | None", metric.gaussian)
        if gaussian is not None:
            gaussian = gaussian.from_row(around.start)
        planes, samples = part._apply_kernel(
            [stack[:, around] for stack in stacks],
            dataclasses.replace(metric, gaussian=gaussian),
            _scaled_progress(progress, block.start * columns, share),
        )
        return planes[:, core], samples

    def _cut_for_kernels(self, count: int) -> list[Chunk[PartAndCore]]:
        owned, margin = self.geometry.atlas.kind == OWNED, kernel_margin(self.parameters)
        return chunks_of_canvas(self._cut_chunk, owned, count, SWEEP_TILE_ROWS, margin, margin)

    def _cut_chunk(self, around: Rectangle, core: Rectangle) -> tuple[GridManifold, Rectangle]:
        """Return a part, and the index of the chunk's own cells within it."""
        inside = np.zeros_like(self.geometry.atlas.kind[around], bool)
        inside[core] = True
        return self.cut(around, inside), core

    def _apply_kernel(
        self, stacks: Sequence[Stack], metric: Metric, progress: Callable[[int], None] | None
    ) -> tuple[Float32s, int]:
        """Average stacks, colours first, in one pass; return also the number of samples in all kernels."""
        channels = joined_channels(self, stacks[0], metric.step, metric.gaussian)
        planes = [plane for stack in stacks for plane in stack]
        return average_planes(
            self.geometry, at_step(self.parameters, metric.step), channels, planes, progress
        )

    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of an owned cell, in which halo cells count as their nearest owned cells."""
        gaussian = self.measure(self.colours, step).gaussian
        channels = joined_channels(self, self.colours, step, gaussian)
        parameters, atlas = at_step(self.parameters, step), self.geometry.atlas
        columns, reach = atlas.kind.shape[1], parameters.window // 2
        row, column = divmod(int(atlas.owned_cells[sample]), columns)
        window = distances_in_window(self.geometry, parameters, channels, (row, column))
        offsets = np.argwhere(np.isfinite(window)) - reach
        distances = window[tuple(offsets.T + reach)]
        # Coincident samples have the distance 0 too, and the cell itself comes first.
        order = np.lexsort([offsets.any(axis=1), distances])
        offsets, distances = offsets[order], distances[order]
        cells = (offsets[:, 0] + row) * columns + offsets[:, 1] + column
        weights = kernel_values(distances, parameters.t)
        if self.geometry.repeats is not None:
            weights /= self.geometry.repeats.reshape(-1)[cells]
        colours = np.ascontiguousarray(self.colours.reshape(len(self.colours), -1)[:, cells].T)
        is_halo = np.isin(cells, atlas.halo.cells)
        cells[is_halo] = atlas.halo.nearest[np.searchsorted(atlas.halo.cells, cells[is_halo])]
        samples = np.searchsorted(atlas.owned_cells, cells)
        return SampledKernel(samples, distances, weights, self.noise.to_input(colours), offsets)

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None, *,
        replaces_pilot: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate the owned cells from patches, and refresh the halo."""
        atlas, relative = self.geometry.atlas, self.noise.relative
        stacks = [noisy, pilot, *([] if relative is None else [relative])]
        estimates = collaborate_on_canvas(
            atlas.kind, stacks, mixing, self.geometry.threads, progress,
            replaces_pilot=replaces_pilot, chunking=self.resources.chunking,
        )  # fmt: skip
        refresh_halo(estimates, atlas)
        return estimates

    def perturbation(self) -> large_arrays.Droppable[Array]:
        atlas, noise = self.geometry.atlas, self.noise
        return large_arrays.Droppable(None, lambda: draw_perturbations(atlas, noise, 1)[0])

    def levels(self, most: int) -> list[Squares]:
        grid, largest = self.geometry, largest_side(self.geometry.atlas, self.parameters)
        sides = (2**level for level in range(1, most + 1))
        return [
            Squares(
                grid.atlas,
                side,
                grid.threads,
                cell_variances=self.noise.relative,
                chunking=self.resources.chunking,
            )
            for side in sides
            if side <= largest
        ]

    @property
    def regions(self) -> Squares:
        """Squares of the finest level of plain colours, averaged over 6 cells."""
        grid, side = self.geometry, 2 ** min(self.plain_levels)
        return Squares(grid.atlas, side, grid.threads, width=6 / side)

    def trial(self) -> SampleTrial:
        atlas, planes, parameters = self.geometry.atlas, self.colours, self.parameters
        budget = BUDGET_ON_GRIDS.of(len(atlas.owned_cells))
        if len(atlas.owned_cells) <= budget:
            part, scored = dataclasses.replace(self, resources=IN_ONE_PIECE), atlas.owned_cells
        else:
            reach = parameters.window // 2 + gaussian_reach(parameters.metric_scale)
            cells, core = choose_blocks(atlas, budget, reach)
            part = cut_blocks(self, cells, core, reach)
            planes = pick(planes, cells)
            planes[:, part.geometry.atlas.kind == EMPTY] = 0
            scored = np.flatnonzero(core & (part.geometry.atlas.kind == OWNED))
        drawn = draw_perturbations(part.geometry.atlas, self.noise, wanted_probes(len(scored)))
        return SampleTrial(part, planes, np.array(drawn, np.float32), scored)

    def cut(self, samples: CellIndex, inside: Bools) -> GridManifold:
        """Cut out a part without its colours, see `GridGeometry.cut`."""
        return self._part_of(self.geometry.cut(samples, inside), lambda stack: pick(stack, samples))

    def new_colours(self) -> NewColours:
        return self._with_outliers(
            canvas_colours(self.geometry.atlas, self.colours).mapped(self.noise.to_input)
        )


def cut_blocks(whole: GridManifold, cells: Int64s, core: Bools, reach: int) -> GridManifold:
    """Cut out blocks. Cells beyond their borders keep their colours, as halo that is not refreshed."""
    side = cells.shape[1]
    at = np.arange(side)
    inner = (at >= reach) & (at < side - reach)
    part = whole.cut(cells, np.tile(inner[:, None] & inner, (len(cells) // side, 1)))
    atlas = with_halo(part.geometry.atlas, whole.geometry.atlas, cells, core)
    return dataclasses.replace(part, geometry=dataclasses.replace(part.geometry, atlas=atlas))


def row_blocks(shape: tuple[int, ...], margin: int, cells: int) -> list[slice]:
    """Return the rows averaged at a time, whole tiles of at least so many cells.

    Each block depends only on adjacent blocks.
    """
    rows, columns = shape
    height = -(-max(cells // max(1, columns), margin, 1) // SWEEP_TILE_ROWS) * SWEEP_TILE_ROWS
    return [slice(top, min(rows, top + height)) for top in range(0, rows, height)]


def _split(planes: Float32s, like: Sequence[Float32s]) -> list[Float32s]:
    return np.split(planes, np.cumsum([len(stack) for stack in like])[:-1])


def _write_rows(stacks: Sequence[Stack], rows: slice, planes: Float32s) -> None:
    for stack, new in zip(stacks, _split(planes, stacks), strict=True):
        stack[:, rows] = new


def _scaled_progress(
    progress: Callable[[int], None] | None, before: int, share: float
) -> Callable[[int], None] | None:
    """Scale the progress of one row block, of whose cells a share is new, and add that of earlier blocks."""
    return None if progress is None else lambda done: progress(before + int(done * share))
