"""N iterations of the short-time Beltrami kernel on the canvas of a texture atlas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.bands import Bands
from beltrami_cli.flow.canvas import Canvas
from beltrami_cli.flow.canvas_choice import choose_on_canvas
from beltrami_cli.flow.canvas_colours import colours_at
from beltrami_cli.flow.cell_fields import CellFields, halo_repeats, local_scales
from beltrami_cli.flow.clipping import ClippedChannels, find_clipped_on_canvas
from beltrami_cli.flow.correlation import estimate_noise_on_grid
from beltrami_cli.flow.grid_metric import GridMetric
from beltrami_cli.flow.one_kernel import SampledKernel, kernel_on_grid
from beltrami_cli.flow.partitions.grid import cut_grid
from beltrami_cli.flow.partitions.splitting import wanted_split
from beltrami_cli.flow.progress import shifted
from beltrami_cli.flow.result import FlowResult
from beltrami_cli.flow.seams import find_colour_jumps, halo_beyond
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED, refresh_halo, without_halo

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.choice import Choice
    from beltrami_cli.flow.guidance import Guide
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# Rows of a canvas that are gone through together.
_ROWS = 64


class TexelFlow:
    """The image manifold of an atlas, ready to be smoothed.

    Parameters
    ----------
    atlas : Atlas
        Canvas with margins of at least half the window, and of the guide's reach besides.
    planes : ndarray of float32, shape (N, R, C)
        Colours on the canvas, in the working space, as `painted` puts them there. They are changed in place.
    parameters : KernelParameters
        What to run with.
    walls : bool
        Whether the regularised metric must not look over empty cells either; see `GridGaussian`.
    guides : sequence of Guide
        Channels that enter the metric and stay as they are; T rows each.
    metric_channels : sequence of int, optional
        Which of the N colour channels enter the metric; without it all.
    unit : float, optional
        The spacing of samples in units of length, by which betas are chosen; without it 1, or the mean pitch if the
        unit of length is that of the surface.

    Attributes
    ----------
    atlas : Atlas
        Without the halo of seams whose two sides really differ.
    spacing : float
        Mean texel pitch on the surface, in its own unit of length.
    sigma : ndarray of float64, shape (N,)
        Estimated noise per channel.
    beta : float
        As used, in units of length per unit of colour; 0 if no colour enters the metric.
    parameters : KernelParameters
        As used, with nothing free.
    choice : Choice or None
        What of them was chosen from the data; None: nothing was.
    guide_betas : dict of str to float
        Units of length per unit of each guide, by its name.
    jumps : int
        Seams whose two sides really differ.
    """

    def __init__(
        self,
        atlas: Atlas,
        planes: NDArray[np.float32],
        parameters: KernelParameters,
        *,
        walls: bool = False,
        guides: Sequence[Guide] = (),
        metric_channels: Sequence[int] | None = None,
        unit: float | None = None,
    ) -> None:
        self.parameters = parameters
        self._planes = planes
        self.sigma, octaves = estimate_noise_on_grid(self._planes, atlas.kind == OWNED)
        different = np.zeros(max(1, atlas.seams), bool)
        # Where colours do not count as distance, a jump of theirs is no edge.
        if parameters.beta != 0 and (metric_channels is None or len(metric_channels)):
            different = find_colour_jumps(atlas, self._planes, self.sigma)
        self.jumps = int(np.count_nonzero(different))
        if self.jumps:
            beyond = halo_beyond(atlas, different)
            atlas = without_halo(atlas, beyond)
            for rows in large_arrays.blocks(len(atlas.kind), _ROWS):
                self._planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
        self.atlas = atlas
        scale = local_scales(atlas, parameters.window)
        self.spacing = _mean_spacing(atlas, scale)
        self._fields = CellFields(
            scale if parameters.units == "spacing" else None, halo_repeats(atlas, parameters.thread_count)
        )
        if unit is None:
            unit = self.spacing if parameters.units == "world" else 1.0
        self._metric = GridMetric(atlas, self.sigma, unit, parameters, guides, metric_channels, walls=walls)
        self.choice: Choice | None = None
        if parameters.is_open:
            parameters, self.choice = choose_on_canvas(
                self._canvas(), self._planes, self.sigma, unit, octaves
            )
            self.parameters = parameters
            self._metric.use(parameters)
        self.beta, self.guide_betas = self._metric.beta, self._metric.guide_betas
        self._clipped = None
        if parameters.clipping == "restore" and self.beta > 0 and parameters.iterations:
            self._clipped = find_clipped_on_canvas(planes, int(np.count_nonzero(atlas.kind)), self.sigma)

    def run(self, progress: Callable[[int, int], None] | None = None) -> FlowResult:
        """Run all iterations.

        Parameters
        ----------
        progress : callable, optional
            Called with the work done so far and the work to do, over all iterations; may raise to stop.

        Returns
        -------
        FlowResult
            What became of the colours is on the canvas, see `colours`.
        """
        parameters = self.parameters
        if self._clipped is None:
            samples = self._iterate([self._planes], progress)
        else:
            marks = self._marks(self._clipped)
            samples = self._iterate([self._planes, marks], progress)
            for rows in large_arrays.blocks(len(self.atlas.kind), _ROWS):
                self._clipped.restore(self._planes[:, rows], marks[:, rows])
        kernels = max(1, parameters.iterations * len(self.atlas.owned_cells))
        return FlowResult(self.spacing, self.beta, self.sigma, samples / kernels, self.choice)

    def _iterate(
        self, stacks: Sequence[NDArray[np.float32]], progress: Callable[[int, int], None] | None
    ) -> float:
        """Run all iterations on stacks of planes, in place; return the samples that kernels held."""
        if wanted_split() is not None:
            return self._iterate_in_pieces(stacks, progress)
        iterations, size, samples = self.parameters.iterations, self.atlas.kind.size, 0
        bands = Bands(self._canvas())
        for iteration in range(iterations):
            samples += bands.iterate(
                stacks, iteration, shifted(progress, iteration * size, iterations * size)
            )
        return samples

    def _iterate_in_pieces(
        self, stacks: Sequence[NDArray[np.float32]], progress: Callable[[int, int], None] | None
    ) -> float:
        """Do what bands do, to the last bit, piece by piece."""
        parameters, split, atlas = self.parameters, wanted_split(), self.atlas
        if split is None or not parameters.iterations or not len(atlas.owned_cells):
            return 0
        canvas = self._canvas()
        flat = [plane.reshape(-1) for stack in stacks for plane in stack]
        values = np.concatenate(
            [colours_at(stack, atlas.owned_cells, parameters.thread_count) for stack in stacks], axis=1
        )
        done = split.run(lambda count, _: cut_grid(canvas, count), 0, values, parameters.iterations, progress)
        for plane, channel in zip(flat, done.values.T, strict=True):
            plane[atlas.owned_cells] = channel
        for stack in stacks:
            refresh_halo(stack, atlas)
        return done.samples

    def _canvas(self) -> Canvas:
        return Canvas(self.atlas, self._fields, self._metric, len(self._planes), self.parameters)

    def _marks(self, clipped: ClippedChannels) -> NDArray[np.float32]:
        """Return the planes to average beside the colours: the marks of samples that were cut off."""
        kind = self.atlas.kind
        marks = large_arrays.empty((len(clipped.clipped), *kind.shape), np.float32)
        for rows in large_arrays.blocks(len(kind), _ROWS):
            marks[:, rows] = np.where(
                kind[rows] == EMPTY, np.float32(0), clipped.marks(self._planes[:, rows])
            )
        refresh_halo(marks, self.atlas)
        return marks

    @property
    def planes(self) -> NDArray[np.float32]:
        """The colours on the canvas as they are now, shape (N, R, C); 0 where cells are empty."""
        return self._planes

    def colours(self) -> NDArray[np.float32]:
        """Return the colours of the owned cells as they are now, shape (T, N)."""
        return colours_at(self._planes, self.atlas.owned_cells, self.parameters.thread_count)

    def kernel_at(self, cell: int) -> SampledKernel:
        """Return the kernel that one more iteration, after those that were run, would have at an owned cell.

        Parameters
        ----------
        cell : int
            Flat index on the atlas's canvas.

        Returns
        -------
        SampledKernel
        """
        metric, beta = self._metric.planes(self._planes, self.parameters.iterations)
        return kernel_on_grid(self.atlas, self._fields, metric, self._planes, beta, self.parameters, cell)

    def gutter_colours(self) -> NDArray[np.float32]:
        """Return the colours that the atlas's gutter cells have now, shape (G, N)."""
        refresh_halo(self._planes, self.atlas, interpolated=True)
        flat, cells = self._planes.reshape(len(self._planes), -1), self.atlas.gutter_cells
        colours = np.zeros((len(cells), len(flat)), np.float32)
        for block in large_arrays.blocks(len(cells), large_arrays.SCATTERED):
            colours[block] = flat[:, cells[block]].T
        return colours


def _mean_spacing(atlas: Atlas, scale: NDArray[np.float32]) -> float:
    """Return the mean length that is 1 in local units, over the owned cells; 0 without any."""
    total, count = 0.0, 0
    for rows in large_arrays.blocks(len(atlas.kind), _ROWS):
        spacing = 1 / np.sqrt(scale[rows][atlas.kind[rows] == OWNED])
        total, count = total + float(spacing.sum(dtype=np.float64)), count + len(spacing)
    return total / count if count else 0.0
