"""Workload of kernels: how many samples they average."""

from __future__ import annotations

import logging
import math

from beltrami_cli.flow.parameters import KernelParameters

_LOG = logging.getLogger(__name__)


class KernelWork:
    """Workload of kernels that a window bounds, as on a grid."""

    def __init__(self, kernels: int, unit: float) -> None:
        self.kernels = kernels
        self._unit = unit or 1.0

    @property
    def has_uniform_density(self) -> bool:
        """Whether the best parameters of parts of the surface are the best for the whole."""
        return True

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Reduce the samples per kernel where the density requires it, unless the user set the limit."""
        return parameters

    def samples(self, parameters: KernelParameters) -> float:
        """Return an upper bound of the number of samples in all kernels of an iteration."""
        return self.kernels * min(self._on_even_surface(parameters), parameters.window**2)

    def announce(self, parameters: KernelParameters) -> None:
        _LOG.info(
            "%d samples are averaged in each of %d iterations, with at most some %.2g million neighbours in all",
            self.kernels, parameters.iterations, parameters.iterations * self.samples(parameters) / 1e6,
        )  # fmt: skip

    def _on_even_surface(self, parameters: KernelParameters) -> float:
        """Return the samples per kernel on equilateral triangles, whose area is sqrt(3) / 4 each."""
        circle, of_sample = math.pi * (parameters.radius / self._unit) ** 2, math.sqrt(3) / 2
        return 1 + circle / of_sample
