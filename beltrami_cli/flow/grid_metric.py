"""What of the cells of a canvas enters the metric, iteration by iteration."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.canvas_colours import painted
from beltrami_cli.flow.grid_noise import estimate_sigma_on_grid
from beltrami_cli.flow.guidance import choose_guide_beta, join_channels
from beltrami_cli.flow.noise import beta_of
from beltrami_cli.flow.regularisation import GridGaussian
from beltrami_cli.flow.seams import find_colour_jumps, halo_beyond
from beltrami_cli.surface.atlas import EMPTY, OWNED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.guidance import Guide
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# The median of so many steps is within 0.3 % of that of all.
_ENOUGH_STEPS = 200_000


class GridMetric:
    """The planes beside the lengths in space that eq. (1) is made of.

    Parameters
    ----------
    atlas : Atlas
        The canvas of R x C cells, T of them owned.
    sigma : ndarray of float64, shape (N,)
        Estimated noise of the colours.
    unit : float
        The texel pitch in units of length.
    parameters : KernelParameters
        What to run with.
    guides : sequence of Guide
        With T rows each, in the order of the owned cells.
    metric_channels : sequence of int or None
        Which of the N colour channels count; None: all.
    walls : bool
        As for `GridGaussian`.

    Attributes
    ----------
    counting : ndarray of float64
        Estimated noise of the colour channels that count.
    beta : float
        Of the colours, in units of length per unit of colour; 0 if none counts.
    guide_betas : dict of str to float
        Units of length per unit of each guide, by its name.
    """

    def __init__(
        self,
        atlas: Atlas,
        sigma: NDArray[np.float64],
        unit: float,
        parameters: KernelParameters,
        guides: Sequence[Guide],
        metric_channels: Sequence[int] | None,
        *,
        walls: bool,
    ) -> None:
        self._atlas, self._parameters, self._unit = atlas, parameters, unit
        self._chosen = None if metric_channels is None else list(metric_channels)
        self.counting = counting = sigma if self._chosen is None else sigma[self._chosen]
        self.beta = beta_of(parameters, counting, unit)
        if not len(counting):
            self.beta = 0.0
        self._walls = walls
        self._gaussian: GridGaussian | None = None
        if parameters.is_regularised(0):
            self._gaussian = self._smoothing(atlas)
        self.guide_betas: dict[str, float] = {}
        self._guide_planes = [self._take(guide) for guide in guides]

    def planes(
        self, colours: NDArray[np.float32], iteration: int, first: int = 0
    ) -> tuple[NDArray[np.float32], float]:
        """Return the planes that an iteration, counted from 0, takes distances from, and their beta.

        Parameters
        ----------
        colours : ndarray of float32, shape (N, K, C)
            As they are before the iteration, halo included, in K rows of the canvas.
        iteration : int
            Counted from 0.
        first : int
            The first of these rows. If they are not all, the planes are right only as far from the first and last as
            the regularised metric reaches.
        """
        if not self._parameters.is_regularised(iteration):
            self._gaussian = None  # its planes are not needed any more
        beta = self.beta * self._parameters.growth(iteration)
        return self.join(colours, beta, first, regularised=self._gaussian is not None)

    def join(
        self, colours: NDArray[np.float32], beta: float, first: int = 0, *, regularised: bool
    ) -> tuple[NDArray[np.float32], float]:
        """Return the planes to take distances from, and their beta, for rows of colours and a beta of these."""
        if self._chosen is not None:
            colours = colours[self._chosen]
        rows = slice(first, first + colours.shape[1])
        own = self._regularised(colours, beta, first) if regularised else (colours, beta)
        return join_channels([own, *((planes[:, rows], beta) for planes, beta in self._guide_planes)], axis=0)

    def use(self, parameters: KernelParameters) -> None:
        """Take other parameters, which were chosen after the metric was made: iterations, beta and the like."""
        self._parameters = parameters
        if parameters.beta is not None and self.beta > 0:
            self.beta = parameters.beta
        if self._gaussian is None and parameters.is_regularised(0):
            self._gaussian = self._smoothing(self._atlas)

    def cut_out(self, atlas: Atlas, cells: NDArray[np.int64]) -> GridMetric:
        """Return the metric of some cells, flat indices of shape (R', C'), on a canvas of their own."""
        part = copy(self)
        part._atlas = atlas
        part._gaussian = None if self._gaussian is None else part._smoothing(atlas)
        part._guide_planes = [
            (np.ascontiguousarray(planes.reshape(len(planes), -1)[:, cells]), beta)
            for planes, beta in self._guide_planes
        ]
        return part

    def _smoothing(self, atlas: Atlas) -> GridGaussian:
        return GridGaussian(
            atlas.kind != EMPTY,
            self._parameters.metric_scale,
            walls=self._walls,
            atlas=atlas,
            threads=self._parameters.thread_count,
        )

    def _regularised(
        self, planes: NDArray[np.float32], beta: float, first: int
    ) -> tuple[NDArray[np.float32], float]:
        """Return what distances are taken from in place of noisy planes, and its beta."""
        if self._gaussian is None or beta == 0:
            return planes, beta
        return self._gaussian.smooth(planes, first), beta / self._gaussian.gain

    def _take(self, guide: Guide) -> tuple[NDArray[np.float32], float]:
        """Return the planes and the beta that a guide adds to the metric, and note the beta."""
        atlas, owned = self._atlas, self._atlas.kind == OWNED
        planes = painted(atlas, guide.values, self._parameters.thread_count)
        if guide.in_chart_frame:
            _end_at_seams(planes, atlas, self._parameters.thread_count)
        beta = guide.beta
        if beta is None:
            beta = choose_guide_beta(guide.values, _steps(planes, owned)) * self._unit
        self.guide_betas[guide.name] = beta
        return planes, beta


def _steps(planes: NDArray[np.float32], owned: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return differences between neighbours along rows, in evenly spread rows, shape (K, G)."""
    rows = np.arange(0, len(owned), max(1, int(np.count_nonzero(owned)) // _ENOUGH_STEPS))
    both = owned[rows, :-1] & owned[rows, 1:]
    return (planes[:, rows, 1:] - planes[:, rows, :-1])[:, both].T


def _end_at_seams(planes: NDArray[np.float32], atlas: Atlas, threads: int) -> None:
    """Continue a guide as a constant, in place, beyond the seams whose two sides differ.

    Such a seam is where the frames of two charts meet, and not an edge of the surface: nothing is to stop there.
    """
    from beltrami_cli._native import nearest_marked

    sigma = estimate_sigma_on_grid(planes, atlas.kind == OWNED)
    beyond = atlas.halo_cells[halo_beyond(atlas, find_colour_jumps(atlas, planes, sigma))]
    if len(beyond):
        wanted = np.zeros(atlas.kind.shape, bool)
        wanted.reshape(-1)[beyond] = True
        cells, nearest = nearest_marked(atlas.kind == OWNED, wanted, max(atlas.kind.shape), threads)
        flat = planes.reshape(len(planes), -1)
        flat[:, cells] = flat[:, nearest]
