"""What an iteration on a manifold takes, and what it gives."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Indices


@dataclass(frozen=True)
class Step:
    """One iteration: beta in units of length per unit of colour, the time step, whether the metric is regularised."""

    beta: float
    t: float
    regularised: bool


@dataclass(frozen=True)
class Averaged:
    """Averages of channels by eq. (9), how many samples the kernels held, and how many kernels were cut short."""

    stacks: list[Float32s]
    samples: float
    truncated: int = 0


@dataclass(frozen=True)
class Mixing:
    """How N channels are mixed so that each can be estimated by itself, shape (N, N), and their noise, shape (N,)."""

    forth: Float32s
    back: Float32s
    variances: Float32s
    has_pilot: bool = field(default=False, kw_only=True)  # patches are compared on an estimate


@dataclass(frozen=True)
class NewColours:
    """Colours of S samples, read block by block, and the colours that continue them beyond seams."""

    take: Callable[[slice, Bools | slice], Float32s]  # a block's rows, all or by a mask
    places: Indices  # texels or pixels of the samples, shape (S,)
    beyond_places: Indices  # texels or pixels around charts, shape (G,)
    beyond: Float32s  # their colours, shape (G, N)

    @classmethod
    def of(
        cls,
        rows: Float32s,
        places: Indices | None = None,
        beyond_places: Indices | None = None,
        beyond: Float32s | None = None,
    ) -> NewColours:
        """Give the rows of a table, shape (S, N)."""
        none = np.zeros(0, np.int64)
        return cls(
            lambda block, inside: rows[block][inside],
            np.arange(len(rows)) if places is None else places,
            none if beyond_places is None else beyond_places,
            np.zeros((0, rows.shape[1]), np.float32) if beyond is None else beyond,
        )

    def mapped(self, each: Callable[[Float32s], Float32s]) -> NewColours:
        """Return what a function makes of rows of colours."""
        take = self.take
        return dataclasses.replace(
            self, take=lambda block, inside: each(take(block, inside)), beyond=each(self.beyond)
        )

    def table(self) -> Float32s:
        """Return all rows, shape (S, N)."""
        return self.take(slice(None), slice(None))


def at_step(parameters: KernelParameters, step: Step) -> KernelParameters:
    """Return parameters with the time step of an iteration, which the radius of kernels follows."""
    return parameters if step.t == parameters.t else dataclasses.replace(parameters, t=step.t)


@dataclass(frozen=True)
class SampledKernel:
    """The K samples in the kernel of one sample p, p first and the others by their distance."""

    samples: Int64s  # of a surface, or flat indices of cells of a canvas, shape (K,)
    distances: Float32s  # d(p, q), in the unit of length of the parameters; 0 at p
    weights: Float32s  # w_q exp(-d(p, q)^2 / (4 t)), eqs. (8, 9), not yet divided by their sum
    colours: Float32s  # I(q), before the iteration, in the working space, shape (K, N)

    @property
    def mean(self) -> Float64s:
        """The colour that the iteration gives p, shape (N,): sum w I / sum w."""
        weights = self.weights.astype(np.float64)
        if not weights.any():  # a sample that stands for no area, alone
            return np.asarray(self.colours[0], np.float64)
        return np.asarray(np.average(self.colours, axis=0, weights=weights), np.float64)


def kernel_values(distances: Float32s, t: float) -> Float32s:
    """Return exp(-d^2 / (4 t)), eq. (8)."""
    return np.asarray(np.exp(-np.square(distances.astype(np.float64)) / (4 * t)), np.float32)
