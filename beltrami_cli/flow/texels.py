"""N iterations of the short-time Beltrami kernel on the canvas of a texture atlas."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.cell_fields import CellFields, halo_repeats
from beltrami_cli.flow.choice import ON_GRIDS, Choice, choose, choose_by_rule, is_noisy
from beltrami_cli.flow.clipping import find_clipped
from beltrami_cli.flow.correlation import is_correlated_on_grid
from beltrami_cli.flow.grid_metric import GridMetric
from beltrami_cli.flow.iteration import FlowResult, shifted
from beltrami_cli.flow.noise import estimate_sigma_on_grid
from beltrami_cli.flow.one_kernel import SampledKernel, kernel_on_grid
from beltrami_cli.flow.pieces.grid import GridFields, cut_grid
from beltrami_cli.flow.pieces.splitting import wanted_split
from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.flow.seams import find_colour_jumps, halo_beyond
from beltrami_cli.flow.trial_grid import GridTrial
from beltrami_cli.mesh.atlas import EMPTY, OWNED, refresh_halo, without_halo

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.guidance import Guide
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.mesh.atlas import Atlas

# The widest window that the sweeps are made for; a wider one is looked through by a heap march.
_WIDEST_SWEEP = 15

# Cells on which parameters are tried, as a share of all, so that trying takes no longer than smoothing: some sixty
# iterations are tried, each twice. Fewer than so many cells tell too little, and take about a second.
_SHARE_TRIED = 1 / 25
_LEAST_TRIED = 25_000


class TexelFlow:
    """The image manifold of an atlas, ready to be smoothed.

    Parameters
    ----------
    atlas : Atlas
        Canvas with margins of at least half the window, and of the guide's reach besides.
    colours : ndarray of float32, shape (T, N)
        Colours of the owned cells, in the working space.
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
        colours: NDArray[np.float32],
        parameters: KernelParameters,
        *,
        walls: bool = False,
        guides: Sequence[Guide] = (),
        metric_channels: Sequence[int] | None = None,
        unit: float | None = None,
    ) -> None:
        from beltrami_cli._native import local_scale

        self.parameters = parameters
        self._planes = np.zeros((colours.shape[1], *atlas.kind.shape), np.float32)
        self._planes.reshape(len(self._planes), -1)[:, atlas.owned_cells] = colours.T
        refresh_halo(self._planes, atlas)
        self.sigma = estimate_sigma_on_grid(self._planes, atlas.kind == OWNED)
        different = np.zeros(max(1, atlas.seams), bool)
        # Where colours do not count as distance, a jump of theirs is no edge.
        if parameters.beta != 0 and (metric_channels is None or len(metric_channels)):
            different = find_colour_jumps(atlas, self._planes, self.sigma)
        self.jumps = int(np.count_nonzero(different))
        if self.jumps:
            beyond = halo_beyond(atlas, different)
            self._planes.reshape(len(self._planes), -1)[:, atlas.halo_cells[beyond]] = 0
            atlas = without_halo(atlas, beyond)
        self.atlas = atlas
        scale = local_scale(atlas.squared_lengths, parameters.window // 2)
        owned_scale = scale.reshape(-1)[atlas.owned_cells]
        self.spacing = float(np.mean(1 / np.sqrt(owned_scale))) if len(owned_scale) else 0.0
        self._fields = CellFields(
            scale if parameters.units == "spacing" else None, halo_repeats(atlas, parameters.thread_count)
        )
        if unit is None:
            unit = self.spacing if parameters.units == "world" else 1.0
        self._metric = GridMetric(atlas, self.sigma, unit, parameters, guides, metric_channels, walls=walls)
        self.choice: Choice | None = None
        if parameters.is_open:
            self.parameters = parameters = self._choose(unit)
        self.beta, self.guide_betas = self._metric.beta, self._metric.guide_betas
        self._clipped = None
        if parameters.clipping == "restore" and self.beta > 0 and parameters.iterations:
            self._clipped = find_clipped(colours, self.sigma)

    def _choose(self, unit: float) -> KernelParameters:
        """Choose the free parameters, and tell the metric of them; without noise they stay as they are."""
        parameters = dataclasses.replace(self.parameters, free=())
        if not (is_noisy(self.sigma) and len(self.atlas.owned_cells)):
            if "iterations" in self.parameters.free:
                parameters = dataclasses.replace(parameters, iterations=0)
        elif is_correlated_on_grid(self._planes, self.atlas.kind == OWNED):
            parameters, self.choice = choose_by_rule(self._metric.beta, self.parameters)
        else:
            budget = max(_LEAST_TRIED, int(len(self.atlas.owned_cells) * _SHARE_TRIED))
            reach = parameters.window // 2 + guide_radius(parameters.metric_scale)
            trial = GridTrial(
                self.atlas, self._planes, self._fields, self._metric, self._iterate, budget, reach
            )
            parameters, self.choice = choose(
                trial, trial.samples, self.sigma, self._metric.counting, unit, self._metric.beta,
                self.parameters, ON_GRIDS,
            )  # fmt: skip
        self._metric.use(parameters)
        return parameters

    def _iterate(
        self,
        atlas: Atlas,
        fields: CellFields,
        metric: NDArray[np.float32],
        planes: NDArray[np.float32],
        beta: float,
        t: float,
    ) -> NDArray[np.float32]:
        """Return the planes after one iteration on some canvas."""
        from beltrami_cli._native import smooth_grid

        own = dataclasses.replace(self.parameters, t=t)
        smoothed, _ = smooth_grid(
            atlas.kind, atlas.squared_lengths, fields.scale, fields.repeats, metric, planes, beta, t, own.radius,
            own.window // 2, self._scheme(), 0, own.thread_count, None,
        )  # fmt: skip
        refresh_halo(smoothed, atlas)
        return smoothed

    def run(self, progress: Callable[[int, int], None] | None = None) -> FlowResult:
        """Run all iterations.

        Parameters
        ----------
        progress : callable, optional
            Called with the work done so far and the work to do, over all iterations; may raise to stop.

        Returns
        -------
        FlowResult
            `colours` are those of the owned cells, shape (T, N).
        """
        parameters, channels = self.parameters, len(self._planes)
        planes = self._with_marks()
        self._planes = np.empty((0, 0, 0), np.float32)  # freed once the first step is done
        if wanted_split() is None:
            planes, samples = self._iterate_all(planes, channels, progress)
        else:
            planes, samples = self._iterate_in_pieces(planes, channels, progress)
        if self._clipped is not None:
            self._clipped.restore(planes[:channels], planes[channels:])
        self._planes = planes = planes[:channels]
        owned = planes.reshape(len(planes), -1)[:, self.atlas.owned_cells]
        kernels = max(1, parameters.iterations * len(self.atlas.owned_cells))
        return FlowResult(
            np.ascontiguousarray(owned.T),
            self.spacing,
            self.beta,
            self.sigma,
            samples / kernels,
            0,
            choice=self.choice,
        )

    def _iterate_all(
        self, planes: NDArray[np.float32], channels: int, progress: Callable[[int, int], None] | None
    ) -> tuple[NDArray[np.float32], float]:
        """Run all iterations on planes of which so many are colours; return them, and the samples held."""
        from beltrami_cli._native import smooth_grid

        parameters, size, samples = self.parameters, self.atlas.kind.size, 0
        for iteration in range(parameters.iterations):
            metric, beta = self._metric.planes(planes[:channels], iteration)
            planes, held = smooth_grid(
                self.atlas.kind,
                self.atlas.squared_lengths,
                self._fields.scale,
                self._fields.repeats,
                metric,
                planes,
                beta,
                parameters.t,
                parameters.radius,
                parameters.window // 2,
                self._scheme(),
                0,
                parameters.thread_count,
                shifted(progress, iteration * size, parameters.iterations * size),
            )
            del metric
            refresh_halo(planes, self.atlas)
            samples += held
        return planes, samples

    def _iterate_in_pieces(
        self, planes: NDArray[np.float32], channels: int, progress: Callable[[int, int], None] | None
    ) -> tuple[NDArray[np.float32], float]:
        """Do what `_iterate_all` does, to the last bit, piece by piece."""
        parameters, split, atlas = self.parameters, wanted_split(), self.atlas
        if split is None or not parameters.iterations or not len(atlas.owned_cells):
            return planes, 0
        fields = GridFields(atlas, self._fields, self._metric, channels, parameters, self._scheme())
        flat = planes.reshape(len(planes), -1)
        values = np.ascontiguousarray(flat[:, atlas.owned_cells].T)
        done = split.run(lambda count, _: cut_grid(fields, count), 0, values, parameters.iterations, progress)
        flat[:, atlas.owned_cells] = done.values.T
        refresh_halo(planes, atlas)
        return planes, done.samples

    def _with_marks(self) -> NDArray[np.float32]:
        """Return the planes to average: the colours, and the marks of samples that were cut off."""
        if self._clipped is None:
            return self._planes
        marks = self._clipped.marks(self._planes)
        marks[:, self.atlas.kind == EMPTY] = 0
        refresh_halo(marks, self.atlas)
        return np.concatenate([self._planes, marks])

    @property
    def planes(self) -> NDArray[np.float32]:
        """The colours on the canvas as they are now, shape (N, R, C); 0 where cells are empty."""
        return self._planes

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
        return kernel_on_grid(
            self.atlas, self._fields, metric, self._planes, beta, self.parameters, self._scheme(), cell
        )

    def gutter_colours(self) -> NDArray[np.float32]:
        """Return the colours that the atlas's gutter cells have now, shape (G, N)."""
        refresh_halo(self._planes, self.atlas, interpolated=True)
        return np.ascontiguousarray(self._planes.reshape(len(self._planes), -1)[:, self.atlas.gutter_cells].T)

    def _scheme(self) -> str:
        if self.parameters.scheme == "metric":
            return "metric"
        return "sweep" if self.parameters.window <= _WIDEST_SWEEP else "triangles"
