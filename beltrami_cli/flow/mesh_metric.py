"""What of the samples of a mesh enters the metric, iteration by iteration."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.guidance import choose_guide_beta, join_channels
from beltrami_cli.flow.noise import beta_of, estimate_sigma
from beltrami_cli.flow.regularisation import MeshGaussian

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.guidance import Guide
    from beltrami_cli.flow.parameters import KernelParameters


class MeshMetric:
    """The channels beside the positions that eq. (1) is made of.

    Parameters
    ----------
    edges : ndarray of int32, shape (E, 2)
        Edges with a length in space, without the walls of hard colour edges.
    lengths : ndarray of float64, shape (E,)
        Their lengths, in sample spacings.
    colours : ndarray of float32, shape (S, N)
        Colours of the samples, to tell their noise.
    unit : float
        The sample spacing in units of length.
    parameters : KernelParameters
        What to run with.
    guides : sequence of Guide
        With S rows each.
    metric_channels : sequence of int or None
        Which of the N colour channels count; None: all.

    Attributes
    ----------
    sigma : ndarray of float64, shape (N,)
        Estimated noise per colour channel.
    counting : ndarray of float64
        Estimated noise of the colour channels that count.
    beta : float
        Of the colours, in units of length per unit of colour; 0 if none counts.
    guide_betas : dict of str to float
        Units of length per unit of each guide, by its name.
    """

    def __init__(
        self,
        edges: NDArray[np.int32],
        lengths: NDArray[np.float64],
        colours: NDArray[np.float32],
        unit: float,
        parameters: KernelParameters,
        guides: Sequence[Guide],
        metric_channels: Sequence[int] | None,
    ) -> None:
        self._parameters, self._unit = parameters, unit
        self._chosen = None if metric_channels is None else list(metric_channels)
        self.sigma = estimate_sigma(colours, edges)
        self.counting = counting = self.sigma if self._chosen is None else self.sigma[self._chosen]
        self.beta = beta_of(parameters, counting, unit)
        if not len(counting):
            self.beta = 0.0
        self._count, self._edges, self._lengths = len(colours), edges, lengths
        self._gaussian: MeshGaussian | None = None
        if parameters.is_regularised(0):
            self._gaussian = self._smoothing()
        self.guide_betas: dict[str, float] = {}
        self._guide_channels = [self._take(guide, edges) for guide in guides]

    def channels(
        self, colours: NDArray[np.float32], iteration: int, normals: tuple[NDArray[np.float32], float] | None
    ) -> tuple[NDArray[np.float32], float]:
        """Return the channels that an iteration takes distances from, and their beta.

        Parameters
        ----------
        colours : ndarray of float32, shape (S, N)
            As they are before the iteration.
        iteration : int
            Counted from 0.
        normals : (ndarray of float32, shape (S, 3), float) or None
            Normals of a surface that moves, and their beta.
        """
        if not self._parameters.is_regularised(iteration):
            self._gaussian = None  # its arrays are not needed any more
        beta = self.beta * self._parameters.growth(iteration)
        moving = [] if normals is None else [self._regularised(*normals)]
        return self.join(colours, beta, moving, regularised=self._gaussian is not None)

    def join(
        self,
        colours: NDArray[np.float32],
        beta: float,
        more: Sequence[tuple[NDArray[np.float32], float]] = (),
        *,
        regularised: bool,
    ) -> tuple[NDArray[np.float32], float]:
        """Return the channels to take distances from, and their beta, for colours and a beta of these."""
        if self._chosen is not None:
            colours = np.ascontiguousarray(colours[:, self._chosen])
        own = self._regularised(colours, beta) if regularised else (colours, beta)
        return join_channels([own, *self._guide_channels, *more], axis=1)

    def use(self, parameters: KernelParameters) -> None:
        """Take other parameters, which were chosen after the metric was made: iterations, beta and the like."""
        self._parameters = parameters
        if parameters.beta is not None and self.beta > 0:
            self.beta = parameters.beta
        if self._gaussian is None and parameters.is_regularised(0):
            self._gaussian = self._smoothing()

    def cut_out(self, samples: NDArray[np.int64]) -> MeshMetric:
        """Return the metric of some samples, ascending, that are a surface of their own."""
        part = copy(self)
        rank = np.full(self._count, -1, np.int32)
        rank[samples] = np.arange(len(samples), dtype=np.int32)
        inside = np.all(rank[self._edges] >= 0, axis=1)
        part._count, part._edges, part._lengths = (
            len(samples),
            rank[self._edges[inside]],
            self._lengths[inside],
        )
        part._gaussian = None if self._gaussian is None else part._smoothing()
        part._guide_channels = [(values[samples], beta) for values, beta in self._guide_channels]
        return part

    def piece(self, rank: NDArray[np.int32], samples: NDArray[np.int64], count: int) -> MeshMetric:
        """Return the metric of a piece, for `join`: what it is on the whole; arguments as for `MeshGaussian.piece`."""
        part = copy(self)
        part._count, part._edges, part._lengths = count, np.zeros((0, 2), np.int32), np.zeros(0)
        part._gaussian = None if self._gaussian is None else self._gaussian.piece(rank, samples, count)
        part._guide_channels = []
        for values, beta in self._guide_channels:
            spread = np.zeros((count, values.shape[1]), values.dtype)
            spread[rank[samples]] = values[samples]
            part._guide_channels.append((spread, beta))
        return part

    def _smoothing(self) -> MeshGaussian:
        return MeshGaussian(self._count, self._edges, self._lengths, self._parameters.metric_scale)

    def _regularised(self, channels: NDArray[np.float32], beta: float) -> tuple[NDArray[np.float32], float]:
        """Return what distances are taken from in place of noisy channels, and its beta."""
        if self._gaussian is None or beta == 0:
            return channels, beta
        return self._gaussian.smooth(channels), beta / self._gaussian.gain

    def _take(self, guide: Guide, edges: NDArray[np.int32]) -> tuple[NDArray[np.float32], float]:
        """Return the channels and the beta that a guide adds to the metric, and note the beta."""
        beta = guide.beta
        if beta is None:
            steps = guide.values[edges[:, 0]] - guide.values[edges[:, 1]]
            beta = choose_guide_beta(guide.values, steps) * self._unit
        self.guide_betas[guide.name] = beta
        return guide.values, beta
