"""The kernels of a regular grid: its metric, averages by it, and parts of the grid.

Large canvases are averaged in place, row block by row block, so that little memory is needed besides the colours.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, ClassVar, Self, cast

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int64s
from beltrami_cli.flow.canvas import colours_at, halo_repeats, local_scales, mean_spacing, without_references
from beltrami_cli.flow.manifold import Manifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import Averaged, SampledKernel, Step, at_step, kernel_values
from beltrami_cli.flow.regularisation import GridGaussian, guide_radius
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas, refresh_halo

# Cells of a row block, some 90 bytes each; more where many threads share them.
ROW_BLOCK_CELLS = 1 << 18
CELLS_PER_THREAD = 1 << 16

# Rows of cut out blocks, which lie all over a canvas, that are picked at a time.
_PICKED_ROWS = 256

# Row blocks end where the tiles of the core end, so that no tile is cut.
TILE_ROWS = 32

# The paper's scheme searches the support of an obtuse quadrant up to this many cells away.
_FURTHEST_SUPPORT = 10

# The paper's scheme takes supports up to ten cells away, and the metric from the cells beside them.
_BEYOND_WINDOW = 12

# The widest window that the sweeps support; wider ones are marched through with a heap.
_WIDEST_SWEEP = 15


class GridKernels(Manifold):
    """Cells of an atlas, with what their kernels need; colours stand on its canvas."""

    axis: ClassVar[int] = 0

    def __init__(
        self,
        atlas: Atlas,
        parameters: KernelParameters,
        metric_channels: Sequence[int] | None,
        *,
        stop_at_holes: bool,
    ) -> None:
        super().__init__(parameters, metric_channels)
        self._stop_at_holes, self._in_one_block = stop_at_holes, False
        self.atlas, self.size, self.kernels = atlas, atlas.kind.size, len(atlas.owned_cells)
        scale = local_scales(atlas, parameters.window)
        self.spacing = mean_spacing(atlas, scale)
        self.scale = scale if parameters.units == "spacing" else None
        self.repeats = halo_repeats(atlas, self.threads)

    @property
    def margin(self) -> int:
        """How many cells around a cell its result in one iteration depends on."""
        own = self.parameters
        support = _FURTHEST_SUPPORT if own.scheme == "metric" else 0
        blurred = guide_radius(own.metric_scale) if own.metric_steps else 0
        return own.window // 2 + 1 + support + blurred

    @property
    def row_blocks(self) -> list[slice]:
        """The rows that are averaged at a time."""
        rows, columns = self.atlas.kind.shape
        if self._in_one_block:
            return [slice(0, rows)]
        wanted = max(ROW_BLOCK_CELLS, CELLS_PER_THREAD * self.threads) // max(1, columns)
        # A block is at least as high as the margin, so that it depends on none but the blocks beside it.
        height = -(-max(wanted, self.margin, 1) // TILE_ROWS) * TILE_ROWS
        return [slice(top, min(rows, top + height)) for top in range(0, rows, height)]

    def in_one_block(self) -> Self:
        """Return the same manifold, which leaves stacks as they are and returns averages in new ones."""
        whole = copy(self)
        whole._in_one_block = True
        return whole

    def measure(self, colours: Float32s, step: Step) -> None:
        """Choose the metric, eq. (1), which is induced row block by row block while they are averaged."""
        self._step, self._count = step, len(colours)
        if step.regularised and step.beta and self._gaussian is None:
            self._gaussian = self._smoothing()

    def average(self, stacks: list[Float32s], progress: Callable[[int], None] | None = None) -> Averaged:
        """Average the channels by eq. (9): in place, unless all is one block."""
        blocks = self.row_blocks
        if len(blocks) < 2:
            after, samples = self._apply_kernel(stacks, progress)
            refresh_halo(after, self.atlas, self.threads)
            return Averaged(_split(after, stacks), samples)
        rows, columns = self.atlas.kind.shape
        samples, finished = 0, None
        for block in blocks:
            large_arrays.leave_memory()
            around = slice(max(0, block.start - self.margin), min(rows, block.stop + self.margin))
            own = slice(block.start - around.start, block.stop - around.start)
            inside = np.zeros((around.stop - around.start, 1), bool)
            inside[own] = True
            part = self.cut(around, inside)
            share = (block.stop - block.start) / len(inside)
            before = [stack[:, around] for stack in stacks]
            after, held = part._apply_kernel(before, _share(progress, block.start * columns, share))
            # The next block depends on what this one replaces, and on nothing above.
            if finished is not None:
                self._put(stacks, *finished)
            finished, samples = (block, after[:, own]), samples + held
        if finished is not None:
            self._put(stacks, *finished)
        large_arrays.leave_memory()
        for stack in stacks:
            refresh_halo(stack, self.atlas, self.threads)
        return Averaged(stacks, samples)

    def _put(self, stacks: Sequence[Float32s], rows: slice, planes: Float32s) -> None:
        """Replace rows of stacks by those of planes, in place."""
        from beltrami_cli._native import copy_planes

        for stack, own in zip(stacks, _split(planes, stacks), strict=True):
            copy_planes(own, stack[:, rows], self.threads)

    def _apply_kernel(
        self, stacks: Sequence[Float32s], progress: Callable[[int], None] | None
    ) -> tuple[Float32s, int]:
        """Average stacks, of which the first holds the colours, at once; return the samples held, too."""
        from beltrami_cli._native import smooth_grid

        own = at_step(self.parameters, self._step)
        distances, beta = self.channels(stacks[0][: self._count], self._step)
        planes = [plane for stack in stacks for plane in stack]
        return smooth_grid(
            self.atlas.kind, self.atlas.squared_lengths, self.scale, self.repeats, distances, planes, beta, own.t,
            own.radius, own.window // 2, scheme_of(own), self.threads, progress,
        )  # fmt: skip

    def cut(self, samples: slice | Int64s, *others: Any) -> Self:
        """Return a part: rows, or cells by flat index, shape (R', C'); `others`: mask of cells that have a kernel."""
        (inside,) = others
        part = copy(self)
        part.colours, part._in_one_block = self.colours[:0], True
        kind = self.pick(self.atlas.kind, samples).copy()
        kind[(kind == OWNED) & ~inside] = HALO
        lengths = self.pick(self.atlas.squared_lengths, samples)
        part.atlas = dataclasses.replace(self.atlas, kind=kind, squared_lengths=lengths)
        part.size = kind.size
        part.scale = None if self.scale is None else self.pick(self.scale, samples)
        part.repeats = None if self.repeats is None else self.pick(self.repeats, samples)
        if self.noise.relative is not None:
            part.noise = self.noise.with_relative(self.pick(self.noise.relative, samples))
        part.guides = [(self.pick(planes, samples), beta) for planes, beta in self.guides]
        if isinstance(samples, slice):
            gaussian = cast("GridGaussian | None", self._gaussian)
            part._gaussian = None if gaussian is None else gaussian.from_row(samples.start)
        else:
            part._gaussian = None
            part.atlas = without_references(part.atlas, self.atlas, samples)
        return part

    def pick(self, planes: Array, samples: slice | Int64s) -> Array:
        """Return rows, or cells, of an array whose last axes are those of the canvas."""
        if isinstance(samples, slice):
            return planes[..., samples, :]
        flat = planes.reshape(*planes.shape[:-2], -1)
        picked = np.empty((*flat.shape[:-1], *samples.shape), planes.dtype)
        for rows in large_arrays.blocks(len(samples), _PICKED_ROWS):
            picked[..., rows, :] = flat[..., samples[rows]]
        return picked

    def rows(self, stacks: Sequence[Float32s]) -> Float32s:
        """Return the channels of all stacks at the owned cells."""
        cells = self.atlas.owned_cells
        return np.concatenate([colours_at(stack, cells, self.threads) for stack in stacks], axis=1)

    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of an owned cell; cells of the halo count as the owned ones that they are nearest to."""
        metric, beta = self.channels(self.colours, step)
        own, atlas = at_step(self.parameters, step), self.atlas
        columns, reach = atlas.kind.shape[1], own.window // 2
        row, column = divmod(int(atlas.owned_cells[sample]), columns)
        window = self._distances(metric, beta, own, (row, column))
        offsets = np.argwhere(np.isfinite(window)) - reach
        distances = window[tuple(offsets.T + reach)]
        # Samples at one place have the distance 0 too, and the cell itself comes first.
        order = np.lexsort([offsets.any(axis=1), distances])
        offsets, distances = offsets[order], distances[order]
        cells = (offsets[:, 0] + row) * columns + offsets[:, 1] + column
        weights = kernel_values(distances, own.t)
        if self.repeats is not None:
            weights /= self.repeats.reshape(-1)[cells]
        colours = np.ascontiguousarray(self.colours.reshape(len(self.colours), -1)[:, cells].T)
        is_halo = np.isin(cells, atlas.halo_cells)
        cells[is_halo] = atlas.halo_nearest[np.searchsorted(atlas.halo_cells, cells[is_halo])]
        samples = np.searchsorted(atlas.owned_cells, cells)
        return SampledKernel(samples, distances, weights, self.noise.to_input(colours), offsets)

    def _distances(
        self, metric: Float32s, beta: float, own: KernelParameters, centre: tuple[int, int]
    ) -> Float32s:
        """Return the distances of the cells in the window of one, infinite beyond the kernel's radius."""
        from beltrami_cli._native import grid_distances

        reach = own.window // 2
        # Nothing further away has an effect, and stencils of a whole canvas take long.
        around = reach + _BEYOND_WINDOW
        top, left = (max(0, place - around) for place in centre)
        part = np.s_[..., top : centre[0] + around + 1, left : centre[1] + around + 1]
        kind = np.ascontiguousarray(self.atlas.kind[part])
        return grid_distances(
            kind, np.ascontiguousarray(self.atlas.squared_lengths[part]),
            None if self.scale is None else np.ascontiguousarray(self.scale[part]),
            np.ascontiguousarray(metric[part]), beta, own.radius, reach, scheme_of(own),
            (centre[0] - top) * kind.shape[1] + centre[1] - left,
        )  # fmt: skip

    def _smoothing(self) -> GridGaussian:
        return GridGaussian(
            self.atlas.kind != EMPTY,
            self.parameters.metric_scale,
            stop_at_holes=self._stop_at_holes,
            atlas=self.atlas,
            threads=self.threads,
        )


def scheme_of(parameters: KernelParameters) -> str:
    """Return the core's name of the scheme by which distances are measured."""
    if parameters.scheme == "metric":
        return "metric"
    return "sweep" if parameters.window <= _WIDEST_SWEEP else "triangles"


def _split(planes: Float32s, like: Sequence[Float32s]) -> list[Float32s]:
    return np.split(planes, np.cumsum([len(stack) for stack in like])[:-1])


def _share(progress: Callable[[int], None] | None, before: int, share: float) -> Callable[[int], None] | None:
    """Add the work of earlier row blocks to the progress of one, of whose cells only a share is new."""
    return None if progress is None else lambda done: progress(before + int(done * share))
