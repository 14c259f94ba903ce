"""The image manifold of colours on a regular grid: the canvas of a texture atlas, or one image.

Large canvases are averaged in place, row block by row block, so that little memory is needed besides the colours.
"""

from __future__ import annotations

import dataclasses
from copy import copy
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from beltrami_cli.flow.canvas import (
    colours_at,
    end_at_seams,
    find_colour_jumps,
    halo_beyond,
    halo_repeats,
    local_scales,
    mean_spacing,
    painted,
    without_references,
)
from beltrami_cli.flow.clipping import find_clipped_on_canvas
from beltrami_cli.flow.kernel_work import KernelWork
from beltrami_cli.flow.manifold import (
    Averaged,
    Manifold,
    NewColours,
    SampledKernel,
    SampleTrial,
    at_step,
    kernel_values,
)
from beltrami_cli.flow.noise.grid import estimate_noise_on_grid
from beltrami_cli.flow.regularisation import GridGaussian, gaussian_taps, guide_radius
from beltrami_cli.flow.search_range import ON_GRIDS, RULE_ON_GRIDS
from beltrami_cli.flow.tuning.grid_trial import (
    choose_blocks,
    perturbations,
    tried_cells,
    with_halo,
)
from beltrami_cli.flow.tuning.sure import wanted_probes
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, refresh_halo, without_halo

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.clipping import ClippedChannels
    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.flow.manifold import Mixing, Step
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# Cells of a row block, some 90 bytes each; more where many threads share them.
ROW_BLOCK_CELLS = 1 << 18
CELLS_PER_THREAD = 1 << 16

# Row blocks end where the tiles of the core end, so that no tile is cut.
TILE_ROWS = 32

# The paper's scheme searches the support of an obtuse quadrant up to this many cells away.
_FURTHEST_SUPPORT = 10

# The paper's scheme takes supports up to ten cells away, and the metric from the cells beside them.
_BEYOND_WINDOW = 12

# The widest window that the sweeps support; wider ones are marched through with a heap.
_WIDEST_SWEEP = 15

# Rows of a canvas that are processed together, where each needs memory.
_ROWS = 64

# Standard deviation of one pass of a wide Gaussian, in cells, whose window the halo fills.
_SPREAD = 1.6

# The median of this many steps is within 0.3 % of that of all.
_ENOUGH_STEPS = 200_000


class GridManifold(Manifold):
    """The image manifold of an atlas, with colours on its canvas that iterations change in place."""

    axis: ClassVar[int] = 0
    width: ClassVar[float] = 6.0
    search_range, rule = ON_GRIDS, RULE_ON_GRIDS

    def __init__(
        self,
        atlas: Atlas,
        planes: NDArray[np.float32],
        parameters: KernelParameters,
        *,
        stop_at_holes: bool = False,
        guides: Sequence[Guide] = (),
        metric_channels: Sequence[int] | None = None,
        unit: float | None = None,
    ) -> None:
        super().__init__(parameters, metric_channels)
        self.colours, self._stop_at_holes, self._in_one_block = planes, stop_at_holes, False
        self.sigma, self.noise_covariances = estimate_noise_on_grid(planes, atlas.kind == OWNED)
        different = np.zeros(max(1, atlas.seams), bool)
        # Where colours do not count as distance, a jump in colour is not an edge.
        if parameters.beta != 0 and (metric_channels is None or len(metric_channels)):
            different = find_colour_jumps(atlas, planes, self.sigma)
        self.jumps = int(np.count_nonzero(different))
        if self.jumps:
            atlas = without_halo(atlas, halo_beyond(atlas, different))
            for rows in large_arrays.blocks(len(atlas.kind), _ROWS):
                planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
        self.atlas, self.size, self.kernels = atlas, atlas.kind.size, len(atlas.owned_cells)
        scale = local_scales(atlas, parameters.window)
        self.spacing = mean_spacing(atlas, scale)
        self.scale = scale if parameters.units == "spacing" else None
        self.repeats = halo_repeats(atlas, self.threads)
        if unit is None:
            unit = self.spacing if parameters.units == "world" else 1.0
        self.unit = unit
        self.embed(guides)

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

    def in_one_block(self) -> GridManifold:
        """Return the same manifold, which leaves stacks as they are and returns averages in new ones."""
        whole = copy(self)
        whole._in_one_block = True
        return whole

    def measure(self, colours: NDArray[np.float32], step: Step) -> None:
        """Choose the metric, eq. (1), which is induced row block by row block while they are averaged."""
        self._step, self._count = step, len(colours)
        if step.regularised and step.beta and self._gaussian is None:
            self._gaussian = self._smoothing()

    def average(
        self, stacks: list[NDArray[np.float32]], progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average the channels by eq. (9): in place, unless all is one block."""
        blocks = self.row_blocks
        if len(blocks) < 2:
            channels = stacks[0] if len(stacks) == 1 else np.concatenate(stacks)
            after, samples = self._apply_kernel(channels, progress)
            refresh_halo(after, self.atlas)
            return Averaged(_split(after, stacks), samples)
        rows, columns = self.atlas.kind.shape
        samples, above = 0, np.zeros((sum(map(len, stacks)), 0, columns), np.float32)
        for block in blocks:
            large_arrays.leave_memory()
            top, bottom = block.start, block.stop
            last = min(rows, bottom + self.margin)
            # What lies above was overwritten by the block before.
            before = np.concatenate([above, np.concatenate([stack[:, top:last] for stack in stacks])], axis=1)
            first = last - before.shape[1]
            inside = np.zeros((before.shape[1], 1), bool)
            inside[top - first : bottom - first] = True
            part = self.cut(slice(first, last), inside)
            share = (bottom - top) / before.shape[1]
            after, held = part._apply_kernel(before, _share(progress, top * columns, share))
            above = before[:, max(0, bottom - self.margin - first) : bottom - first].copy()
            del before, part
            for stack, new in zip(stacks, _split(after, stacks), strict=True):
                stack[:, block] = new[:, top - first : bottom - first]
            samples += held
        large_arrays.leave_memory()
        for stack in stacks:
            refresh_halo(stack, self.atlas)
        return Averaged(stacks, samples)

    def _apply_kernel(
        self, planes: NDArray[np.float32], progress: Callable[[int], None] | None
    ) -> tuple[NDArray[np.float32], int]:
        """Average planes at once; return them, and the samples held."""
        from beltrami_cli._native import smooth_grid

        own = at_step(self.parameters, self._step)
        distances, beta = self.channels(planes[: self._count], self._step)
        return smooth_grid(
            self.atlas.kind, self.atlas.squared_lengths, self.scale, self.repeats, distances, planes, beta, own.t,
            own.radius, own.window // 2, scheme_of(own), self.threads, progress,
        )  # fmt: skip

    def cut(self, samples: slice | NDArray[np.int64], *others: Any) -> GridManifold:
        """Return a part: rows, or cells by flat index, shape (R', C'); `others`: mask of cells that have a kernel."""
        (inside,) = others
        part = copy(self)
        part.colours, part._in_one_block = self.colours[:0], True
        kind = self._take(self.atlas.kind, samples).copy()
        kind[(kind == OWNED) & ~inside] = HALO
        lengths = np.ascontiguousarray(self._take(self.atlas.squared_lengths, samples))
        part.atlas = dataclasses.replace(self.atlas, kind=kind, squared_lengths=lengths)
        part.size = kind.size
        part.scale = None if self.scale is None else self._take(self.scale, samples)
        part.repeats = None if self.repeats is None else self._take(self.repeats, samples)
        part.guides = [(self._take(planes, samples), beta) for planes, beta in self.guides]
        if isinstance(samples, slice):
            gaussian = cast("GridGaussian | None", self._gaussian)
            part._gaussian = None if gaussian is None else gaussian.from_row(samples.start)
        else:
            part._gaussian = None
            part.atlas = without_references(part.atlas, self.atlas, samples)
        return part

    def _take(self, planes: NDArray[Any], samples: slice | NDArray[np.int64]) -> NDArray[Any]:
        """Return rows, or cells, of an array whose last axes are those of the canvas."""
        if isinstance(samples, slice):
            return planes[..., samples, :]
        return np.ascontiguousarray(planes.reshape(*planes.shape[:-2], -1)[..., samples])

    @property
    def work(self) -> KernelWork:
        """How much work its kernels are."""
        return KernelWork(self.kernels, self.unit)

    def trial(self) -> SampleTrial:
        """Choose blocks of the canvas, and draw the perturbations of their colours."""
        atlas, planes, own = self.atlas, self.colours, self.parameters
        budget = tried_cells(atlas)
        if len(atlas.owned_cells) <= budget:
            part, scored = self.in_one_block(), atlas.owned_cells
        else:
            reach = own.window // 2 + guide_radius(own.metric_scale)
            cells, core = choose_blocks(atlas, budget, reach)
            part = self.cut_blocks(cells, core, reach)
            planes = self._take(planes, cells)
            planes[:, part.atlas.kind == EMPTY] = 0
            scored = np.flatnonzero(core & (part.atlas.kind == OWNED))
        signs = perturbations(wanted_probes(len(scored)), len(planes), part.atlas, self.noise_covariances)
        return SampleTrial(part, planes, signs, scored, correlated=self.noise_covariances is not None)

    def cut_blocks(self, cells: NDArray[np.int64], core: NDArray[np.bool_], reach: int) -> GridManifold:
        """Cut out blocks; cells beyond their borders keep their colours, as halo that is not refreshed."""
        side = cells.shape[1]
        at = np.arange(side)
        inner = (at >= reach) & (at < side - reach)
        part = self.cut(cells, np.tile(inner[:, None] & inner, (len(cells) // side, 1)))
        part.atlas = with_halo(part.atlas, self.atlas, cells, core)
        return part

    def release(self) -> None:
        """Keep everything: averages need all that cuts need."""

    def rows(self, stacks: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """Return the channels of all stacks at the owned cells."""
        cells = self.atlas.owned_cells
        return np.concatenate([colours_at(stack, cells, self.threads) for stack in stacks], axis=1)

    def put_rows(self, rows: NDArray[np.float32], stacks: Sequence[NDArray[np.float32]]) -> None:
        """Put rows of the owned cells back, and give the halo its values."""
        planes = [plane.reshape(-1) for stack in stacks for plane in stack]
        for plane, channel in zip(planes, rows.T, strict=True):
            plane[self.atlas.owned_cells] = channel
        for stack in stacks:
            refresh_halo(stack, self.atlas)

    def take(self, stack: NDArray[np.float32], samples: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the channels of some cells, by their flat indices, with a row a cell."""
        return stack.reshape(len(stack), -1)[:, samples].T

    def values(self) -> NDArray[np.float32]:
        """Return the colours of the owned cells as they are now, shape (T, N)."""
        return colours_at(self.colours, self.atlas.owned_cells, self.threads)

    def new_colours(self) -> NewColours:
        """Return the colours of the owned cells as they are now, and those of the gutter."""
        refresh_halo(self.colours, self.atlas, interpolated=True)
        planes, cells, threads = self.colours, self.atlas.owned_cells, self.threads
        flat, gutter = planes.reshape(len(planes), -1), self.atlas.gutter_cells
        beyond = np.zeros((len(gutter), len(flat)), np.float32)
        for block in large_arrays.blocks(len(gutter), large_arrays.SCATTERED):
            beyond[block] = flat[:, gutter[block]].T
        return NewColours(
            lambda block, inside: colours_at(planes, cells[block][inside], threads),
            self.atlas.owned_texels,
            self.atlas.gutter_texels,
            beyond,
        )

    def find_clipped(self) -> ClippedChannels | None:
        """Find the channels that were cut off."""
        return find_clipped_on_canvas(self.colours, int(np.count_nonzero(self.atlas.kind)), self.sigma)

    def marks(self, clipped: ClippedChannels) -> NDArray[np.float32]:
        """Return the marks of the cells at a limit, shape (M, R, C)."""
        kind = self.atlas.kind
        marks = large_arrays.empty((len(clipped.clipped), *kind.shape), np.float32)
        for rows in large_arrays.blocks(len(kind), _ROWS):
            marks[:, rows] = np.where(
                kind[rows] == EMPTY, np.float32(0), clipped.marks(self.colours[:, rows])
            )
        refresh_halo(marks, self.atlas)
        return marks

    def restore(
        self, clipped: ClippedChannels, colours: NDArray[np.float32], marks: NDArray[np.float32]
    ) -> None:
        """Turn averages of clipped colours into estimates of the colours without noise."""
        for rows in large_arrays.blocks(len(self.atlas.kind), _ROWS):
            clipped.restore(colours[:, rows], marks[:, rows])

    @property
    def shares_noise(self) -> bool:
        """Whether neighbouring cells share noise."""
        return self.noise_covariances is not None

    def collaborate(
        self,
        noisy: NDArray[np.float32],
        pilot: NDArray[np.float32],
        mixing: Mixing,
        *,
        has_pilot: bool,
        progress: Callable[[int], None] | None = None,
    ) -> NDArray[np.float32]:
        """Estimate the colours of the owned cells from patches, and show them in the halo."""
        from beltrami_cli._native import collaborate_on_grid

        estimates, weights = (large_arrays.zeros(noisy.shape, np.float32) for _ in range(2))
        own = mixing.forth, mixing.back, mixing.variances

        def report(done: int) -> None:
            large_arrays.leave_memory()
            if progress is not None:
                progress(done)

        collaborate_on_grid(
            self.atlas.kind, noisy, pilot, own, None, has_pilot, estimates, weights, self.threads, report
        )
        refresh_halo(estimates, self.atlas)
        return estimates

    def perturbation(self) -> NDArray[np.float32]:
        """Return random planes like the noise: independent signs, or correlated as the noise is."""
        planes: NDArray[np.float32] = perturbations(1, len(self.colours), self.atlas, self.noise_covariances)[
            0
        ]
        return planes

    def planes(self, count: int) -> NDArray[np.float32]:
        """Return planes of zeros."""
        planes: NDArray[np.float32] = large_arrays.zeros((count, *self.atlas.kind.shape), np.float32)
        return planes

    def total(self, planes: NDArray[np.float32]) -> NDArray[np.float64]:
        """Sum planes over the owned cells."""
        kind, total = self.atlas.kind, np.zeros(len(planes))
        for rows in large_arrays.blocks(len(kind), _ROWS):
            total += planes[:, rows].sum(axis=(1, 2), dtype=np.float64, where=kind[rows] == OWNED)
        return total

    def spread(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Average planes over the surface, in passes that reach as far as the halo."""
        from beltrami_cli._native import convolve

        taps = gaussian_taps(_SPREAD)
        reach, kind = len(taps) // 2, self.atlas.kind
        for _ in range(round((self.width / _SPREAD) ** 2)):
            after = self.planes(len(planes))
            for rows in large_arrays.blocks(len(kind), _ROWS):
                first = max(0, rows.start - reach)
                part = np.ascontiguousarray(planes[:, first : rows.stop + reach])
                after[:, rows] = convolve(part, taps, self.threads)[:, rows.start - first :][
                    :, : rows.stop - rows.start
                ]
                after[:, rows] *= kind[rows] != EMPTY
            refresh_halo(after, self.atlas)
            planes = after
        return planes

    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of an owned cell, by its flat index."""
        metric, beta = self.channels(self.colours, step)
        own = at_step(self.parameters, step)
        columns, reach = self.atlas.kind.shape[1], own.window // 2
        row, column = divmod(sample, columns)
        window = self._distances(metric, beta, own, (row, column))
        y, x = np.nonzero(np.isfinite(window))
        order = np.argsort(window[y, x], kind="stable")
        y, x = y[order], x[order]
        cells = (row + y - reach) * columns + column + x - reach
        # Samples at one place have the distance 0 too.
        first = np.argsort(cells != sample, kind="stable")
        distances, cells = window[y, x][first], cells[first]
        weights = kernel_values(distances, own.t)
        if self.repeats is not None:
            weights /= self.repeats.reshape(-1)[cells]
        colours = np.ascontiguousarray(self.colours.reshape(len(self.colours), -1)[:, cells].T)
        return SampledKernel(cells.astype(np.int64), distances, weights, colours)

    def _distances(
        self, metric: NDArray[np.float32], beta: float, own: KernelParameters, centre: tuple[int, int]
    ) -> NDArray[np.float32]:
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

    def _laid_out(self, guide: Guide) -> NDArray[np.float32]:
        planes = painted(self.atlas, guide.values, self.threads)
        if guide.in_chart_frame:
            end_at_seams(planes, self.atlas, self.threads)
        return planes

    def steps(self, stack: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return differences between neighbours along rows, in evenly spread rows, shape (K, G)."""
        owned = self.atlas.kind == OWNED
        rows = np.arange(0, len(owned), max(1, int(np.count_nonzero(owned)) // _ENOUGH_STEPS))
        both = owned[rows, :-1] & owned[rows, 1:]
        return (stack[:, rows, 1:] - stack[:, rows, :-1])[:, both].T


def scheme_of(parameters: KernelParameters) -> str:
    """Return the core's name of the scheme by which distances are measured."""
    if parameters.scheme == "metric":
        return "metric"
    return "sweep" if parameters.window <= _WIDEST_SWEEP else "triangles"


def _split(planes: NDArray[np.float32], like: Sequence[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    return np.split(planes, np.cumsum([len(stack) for stack in like])[:-1])


def _share(progress: Callable[[int], None] | None, before: int, share: float) -> Callable[[int], None] | None:
    """Add the work of earlier row blocks to the progress of one, of whose cells only a share is new."""
    return None if progress is None else lambda done: progress(before + int(done * share))
