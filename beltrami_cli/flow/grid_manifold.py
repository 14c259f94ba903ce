"""The image manifold of colours on a regular grid: the canvas of a texture atlas, or one image."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.canvas import (
    collaborate_on_canvas,
    colours_at,
    end_at_seams,
    find_colour_jumps,
    halo_beyond,
    painted,
)
from beltrami_cli.flow.cell_squares import Squares, squares_for
from beltrami_cli.flow.clipping import ClippedChannels, find_clipped_on_canvas
from beltrami_cli.flow.domain import Stack
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.flow.grid_kernels import GridKernels
from beltrami_cli.flow.grid_partitions import GridPartition, cut_grid
from beltrami_cli.flow.manifold import SampleTrial
from beltrami_cli.flow.noise.by_place import find_relative_noise, relative_to_mean
from beltrami_cli.flow.noise.by_scale import FoundNoise
from beltrami_cli.flow.noise.estimate import NoiseByPlace, estimate_noise
from beltrami_cli.flow.noise.grid_scales import estimate_sigma_on_grid, find_grid_noise
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.noise.stabilising import VarianceStabiliser
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import KernelWork, Mixing, NewColours, Step
from beltrami_cli.flow.regularisation import gaussian_taps, guide_radius
from beltrami_cli.flow.search_range import ON_GRIDS, RULE_ON_GRIDS
from beltrami_cli.flow.tuning.grid_trial import choose_blocks, perturbations, tried_cells, with_halo
from beltrami_cli.flow.tuning.sure import wanted_probes
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED, Atlas, refresh_halo, without_halo

# Rows of a canvas that are processed together, where each needs memory.
_ROWS = 64

# Standard deviation of one pass of a wide Gaussian, in cells, whose window the halo fills.
_SPREAD = 1.6

# The median of this many steps is within 0.3 % of that of all.
_ENOUGH_STEPS = 200_000


@dataclass(frozen=True)
class Whole:
    """What a part of a surface takes from the whole; noise that is None is found on the part."""

    unit: float | None = None  # None: its own
    noise: FoundNoise | None = None


@dataclass(frozen=True)
class NoisyCanvas:
    """Colours on a canvas, shape (N, R, C), as samples to estimate noise on."""

    planes: Float32s
    filled: Bools

    def noise_by_place(self) -> NoiseByPlace:
        found = find_relative_noise(self.planes, self.filled)
        if found is None:
            return NoiseByPlace()
        relative, scale, most = found
        return NoiseByPlace(relative[None], most, scale)

    def noise_by_scale(self, relative: Float32s | None, *, by_level: bool) -> FoundNoise:
        return find_grid_noise(self.planes, self.filled, by_level=by_level, relative=relative)

    def sigma(self, relative: Float32s | None) -> Float64s:
        del relative  # its mean is 1
        return estimate_sigma_on_grid(self.planes, self.filled)

    def stabilise(self, stabiliser: VarianceStabiliser) -> None:
        for rows in large_arrays.blocks(self.planes.shape[1], _ROWS):
            stabiliser.stabilise(self.planes[:, rows])


def grid_manifold(
    atlas: Atlas,
    planes: Float32s,
    parameters: KernelParameters,
    *,
    stop_at_holes: bool = False,
    guides: Sequence[Guide] = (),
    metric_channels: Sequence[int] | None = None,
    deviations: Float32s | None = None,
    whole: Whole | None = None,
) -> GridManifold:
    """Make the image manifold of an atlas with colours on its canvas, which are taken over."""
    measured, known = None, None if whole is None else whole.noise
    if deviations is not None and known is None:
        of_samples, sigma = relative_to_mean(deviations)
        relative = painted(atlas, of_samples, parameters.thread_count)
        relative[relative == 0] = 1  # in empty cells
        measured = relative, sigma
    noise = estimate_noise(
        NoisyCanvas(planes, atlas.kind == OWNED),
        parameters.given_noise,
        varies=parameters.evens_noise,
        least=parameters.least_noise,
        measured=measured,
        known=known,
    )
    different = np.zeros(max(1, atlas.seams), bool)
    # Where colours do not count as distance, a jump in colour is not an edge.
    if parameters.beta != 0 and (metric_channels is None or len(metric_channels)):
        different = find_colour_jumps(atlas, planes, noise.sigma)
    if different.any():
        atlas = without_halo(atlas, halo_beyond(atlas, different))
        for rows in large_arrays.blocks(len(atlas.kind), _ROWS):
            planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
    made = GridManifold(atlas, parameters, metric_channels, stop_at_holes=stop_at_holes)
    made.colours, made.noise, made.jumps = planes, noise, int(np.count_nonzero(different))
    made.unit = made.spacing if parameters.units == "world" else 1.0
    if whole is not None and whole.unit is not None:
        made.unit = whole.unit
    made.lay_out_guides(guides)
    return made


class GridManifold(GridKernels):
    """The image manifold of an atlas, with colours on its canvas that iterations change in place."""

    width: ClassVar[float] = 6.0
    plain_levels: ClassVar[tuple[int, ...]] = 3, 2
    search_range, rule = ON_GRIDS, RULE_ON_GRIDS

    jumps = 0
    """Seams over which colours jump, which end the surface for kernels."""

    def single(self, marked: Bools) -> Bools:
        """Return which of the marked cells, shape (R, C), have no marked ones among the eight beside them."""
        counts = np.pad(marked, 1).astype(np.uint8)
        counts = counts[:-2] + counts[1:-1] + counts[2:]
        single: Bools = counts[:, :-2] + counts[:, 1:-1] + counts[:, 2:] == 1
        return marked & single

    def levels(self, most: int, tick: Callable[[], None] | None = None) -> list[Squares]:
        """Return squares of cells."""
        return squares_for(self, most, tick)

    def refresh(self, stack: Stack) -> None:
        """Give the halo the colours of the cells that it shows."""
        refresh_halo(stack, self.atlas, self.threads)

    def partitions(
        self, count: int, widening: int, steps: Sequence[Step], channels: int
    ) -> list[GridPartition]:
        """Cut into partitions, whose margins are always wide enough."""
        del widening
        return cut_grid(self, count, steps, channels)

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
            planes = self.pick(planes, cells)
            planes[:, part.atlas.kind == EMPTY] = 0
            scored = np.flatnonzero(core & (part.atlas.kind == OWNED))
        drawn = perturbations(wanted_probes(len(scored)), len(planes), part.atlas, self.noise.covariances)
        signs = np.array(drawn, np.float32)
        return SampleTrial(part, planes, signs, scored, correlated=self.noise.is_shared)

    def cut_blocks(self, cells: Int64s, core: Bools, reach: int) -> GridManifold:
        """Cut out blocks; cells beyond their borders keep their colours, as halo that is not refreshed."""
        side = cells.shape[1]
        at = np.arange(side)
        inner = (at >= reach) & (at < side - reach)
        part = self.cut(cells, np.tile(inner[:, None] & inner, (len(cells) // side, 1)))
        part.atlas = with_halo(part.atlas, self.atlas, cells, core)
        return part

    def release(self) -> None:
        """Keep everything: averages need all that cuts need."""

    def put_rows(self, rows: Float32s, stacks: Sequence[Float32s]) -> None:
        """Put rows of the owned cells back, and give the halo its values."""
        planes = [plane.reshape(-1) for stack in stacks for plane in stack]
        for plane, channel in zip(planes, rows.T, strict=True):
            plane[self.atlas.owned_cells] = channel
        for stack in stacks:
            refresh_halo(stack, self.atlas, self.threads)

    def take(self, stack: Float32s, samples: Int64s) -> Float32s:
        """Return the channels of some cells, by their flat indices, with a row a cell."""
        return colours_at(stack, samples, self.threads)

    def values(self) -> Float32s:
        """Return the colours of the owned cells as they are now, shape (T, N)."""
        return self.noise.to_input(colours_at(self.colours, self.atlas.owned_cells, self.threads))

    def new_colours(self) -> NewColours:
        """Return the colours of the owned cells as they are now, and those of the gutter."""
        return canvas_colours(self.atlas, self.colours, self.threads).mapped(self.noise.to_input)

    def find_clipped(self) -> ClippedChannels | None:
        """Find the channels that were cut off."""
        return find_clipped_on_canvas(self.colours, int(np.count_nonzero(self.atlas.kind)), self.noise.sigma)

    def marks(self, clipped: ClippedChannels) -> Float32s:
        """Return the marks of the cells at a limit, shape (M, R, C)."""
        kind = self.atlas.kind
        marks = large_arrays.empty((len(clipped.clipped), *kind.shape), np.float32)
        for rows in self._blocks():
            marks[:, rows] = clipped.marks(self.colours[:, rows], self.threads)
            np.copyto(marks[:, rows], 0, where=kind[rows] == EMPTY)
        refresh_halo(marks, self.atlas, self.threads)
        return marks

    def restore(self, clipped: ClippedChannels, colours: Float32s, marks: Float32s) -> None:
        """Turn averages of clipped colours into estimates of the colours without noise."""
        for rows in self._blocks():
            clipped.restore(colours[:, rows], marks[:, rows], self.relative[0, rows], self.threads)

    def _blocks(self) -> Iterator[slice]:
        """Go through the rows in blocks of `large_arrays.BLOCK` cells."""
        rows, columns = self.atlas.kind.shape
        return large_arrays.blocks(rows, max(_ROWS, large_arrays.BLOCK // max(1, columns)))

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None
    ) -> Stack:
        """Estimate the colours of the owned cells from patches, and show them in the halo."""
        estimates = collaborate_on_canvas(
            self.atlas.kind, noisy, pilot, mixing, self.threads, progress, relative=self.noise.relative
        )
        refresh_halo(estimates, self.atlas, self.threads)
        return estimates

    def perturbation(self) -> Array:
        """Return random planes like the noise: independent signs, or correlated as the noise is."""
        return perturbations(1, len(self.colours), self.atlas, self.noise.covariances)[0]

    def planes(self, count: int) -> Float32s:
        """Return planes of zeros."""
        planes: Float32s = large_arrays.zeros((count, *self.atlas.kind.shape), np.float32)
        return planes

    def total(self, planes: Float32s) -> Float64s:
        """Sum planes over the owned cells."""
        kind, total = self.atlas.kind, np.zeros(len(planes))
        for rows in large_arrays.blocks(len(kind), _ROWS):
            own = np.where(kind[rows] == OWNED, planes[:, rows], np.float32(0))
            total += own.sum(axis=(1, 2), dtype=np.float64)
        return total

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the surface, in passes that reach as far as the halo."""
        from beltrami_cli._native import convolve_to

        taps = gaussian_taps(_SPREAD)
        reach, kind = len(taps) // 2, self.atlas.kind
        before, after = self.planes(len(planes)), self.planes(len(planes))
        for rows in self._blocks():
            np.multiply(planes[:, rows], kind[rows] != EMPTY, out=before[:, rows])
        for _ in range(round((self.width / _SPREAD) ** 2)):
            for rows in self._blocks():
                first = max(0, rows.start - reach)
                around = slice(first, rows.stop + reach)
                convolve_to(
                    before[:, around], taps, rows.start - first, kind[around], after[:, rows], self.threads
                )
            refresh_halo(after, self.atlas, self.threads)
            before, after = after, before
        return before

    def _laid_out(self, guide: Guide) -> Float32s:
        planes = painted(self.atlas, guide.values, self.threads)
        if guide.in_chart_frame:
            end_at_seams(planes, self.atlas, self.threads)
        return planes

    def steps(self, stack: Float32s) -> Float32s:
        """Return differences between neighbours along rows, in evenly spread rows, shape (K, G)."""
        owned = self.atlas.kind == OWNED
        rows = np.arange(0, len(owned), max(1, int(np.count_nonzero(owned)) // _ENOUGH_STEPS))
        both = owned[rows, :-1] & owned[rows, 1:]
        return (stack[:, rows, 1:] - stack[:, rows, :-1])[:, both].T


def canvas_colours(atlas: Atlas, planes: Float32s, threads: int) -> NewColours:
    """Return the colours of the owned cells, read from the canvas when they are taken, and those of the gutter."""
    refresh_halo(planes, atlas, threads, interpolated=True)
    flat, cells, gutter = planes.reshape(len(planes), -1), atlas.owned_cells, atlas.gutter_cells
    beyond = np.zeros((len(gutter), len(flat)), np.float32)
    for block in large_arrays.blocks(len(gutter), large_arrays.SCATTERED):
        beyond[block] = flat[:, gutter[block]].T
    return NewColours(
        lambda block, inside: colours_at(planes, cells[block][inside], threads),
        atlas.owned_texels,
        atlas.gutter_texels,
        beyond,
    )


def common_noise(noise: NoiseModel) -> FoundNoise:
    """Return noise for other parts of the same surface: not its size where that differs from place to place."""
    differs = noise.relative is not None and noise.covariances is None
    return FoundNoise(noise.stabiliser, noise.covariances, noise.doubt, None if differs else noise.sigma)
