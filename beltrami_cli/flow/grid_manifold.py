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
from beltrami_cli.flow.noise.grid_scales import estimate_sigma_on_grid, find_grid_noise
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances
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


class GridManifold(GridKernels):
    """The image manifold of an atlas, with colours on its canvas that iterations change in place."""

    width: ClassVar[float] = 6.0
    plain_levels: ClassVar[tuple[int, ...]] = 3, 2
    search_range, rule = ON_GRIDS, RULE_ON_GRIDS

    def __init__(
        self,
        atlas: Atlas,
        planes: Float32s,
        parameters: KernelParameters,
        *,
        stop_at_holes: bool = False,
        guides: Sequence[Guide] = (),
        metric_channels: Sequence[int] | None = None,
        unit: float | None = None,
        deviations: Float32s | None = None,
        whole: Whole | None = None,
    ) -> None:
        self.colours = planes
        if whole is None or whole.noise is None:
            self._find_noise(atlas, parameters, deviations)
        else:
            self._take_noise(whole.noise, atlas.kind == OWNED)
        different = np.zeros(max(1, atlas.seams), bool)
        # Where colours do not count as distance, a jump in colour is not an edge.
        if parameters.beta != 0 and (metric_channels is None or len(metric_channels)):
            different = find_colour_jumps(atlas, planes, self.sigma)
        self.jumps = int(np.count_nonzero(different))
        if self.jumps:
            atlas = without_halo(atlas, halo_beyond(atlas, different))
            for rows in large_arrays.blocks(len(atlas.kind), _ROWS):
                planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
        super().__init__(atlas, parameters, metric_channels, stop_at_holes=stop_at_holes)
        self.unit = self.spacing if parameters.units == "world" else 1.0
        if whole is not None and whole.unit is not None:
            self.unit = whole.unit
        self.embed(guides)

    def _find_noise(self, atlas: Atlas, parameters: KernelParameters, deviations: Float32s | None) -> None:
        """Estimate the noise where it is not given, and make it even at all levels if it is not."""
        planes, filled, given, sigma = self.colours, atlas.kind == OWNED, parameters.given_noise, None
        if deviations is not None:
            relative, sigma = relative_to_mean(deviations)
            self.differing = painted(atlas, relative, parameters.thread_count)
            self.differing[self.differing == 0] = 1  # in empty cells
        is_given = given is not None or sigma is not None
        differs = None if is_given or not parameters.evens_noise else find_relative_noise(planes, filled)
        if differs is not None:
            self.differing = differs[0][None]
        if not is_given:
            noise = find_grid_noise(planes, filled, by_level=parameters.evens_noise, relative=self.differing)
            self.take_found(noise)
        elif given is not None and given.is_by_level:
            self.stabiliser = given.stabiliser()
        self._stabilise()
        self.sigma = estimate_sigma_on_grid(planes, filled)
        if differs is not None:  # of quiet places
            self.sigma = np.minimum(self.sigma, differs[2]) * differs[1]
        self.settle_noise(parameters, sigma)
        if self.noise_covariances is not None:
            self.sigma = sigma_of_covariances(self.noise_covariances)

    def _take_noise(self, noise: FoundNoise, filled: Bools) -> None:
        """Take the noise that was found on the whole; what is not known is estimated."""
        self.take_found(noise)
        self._stabilise()
        self.sigma = estimate_sigma_on_grid(self.colours, filled) if noise.sigma is None else noise.sigma

    def _stabilise(self) -> None:
        if self.stabiliser is not None:
            for rows in large_arrays.blocks(self.colours.shape[1], _ROWS):
                self.stabiliser.stabilise(self.colours[:, rows])

    @property
    def common_noise(self) -> FoundNoise:
        """The noise as found, for other parts of the surface: not its size where that differs from place to place."""
        differs = self.differing is not None and self.noise_covariances is None
        sigma = None if differs else self.sigma
        return FoundNoise(self.stabiliser, self.noise_covariances, self.doubt, sigma)

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
        drawn = perturbations(wanted_probes(len(scored)), len(planes), part.atlas, self.noise_covariances)
        signs = np.array(drawn, np.float32)
        return SampleTrial(part, planes, signs, scored, correlated=self.noise_covariances is not None)

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
        return self.as_given(colours_at(self.colours, self.atlas.owned_cells, self.threads))

    def new_colours(self) -> NewColours:
        """Return the colours of the owned cells as they are now, and those of the gutter."""
        return canvas_colours(self.atlas, self.colours, self.threads).mapped(self.as_given)

    def find_clipped(self) -> ClippedChannels | None:
        """Find the channels that were cut off."""
        return find_clipped_on_canvas(self.colours, int(np.count_nonzero(self.atlas.kind)), self.sigma)

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
            self.atlas.kind, noisy, pilot, mixing, self.threads, progress, relative=self.differing
        )
        refresh_halo(estimates, self.atlas, self.threads)
        return estimates

    def perturbation(self) -> Array:
        """Return random planes like the noise: independent signs, or correlated as the noise is."""
        return perturbations(1, len(self.colours), self.atlas, self.noise_covariances)[0]

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
