"""The colours that a manifold is made of, and the outliers that were filled in them."""

from __future__ import annotations

from dataclasses import dataclass

from beltrami_cli.arrays import Bools, Float32s, Int64s
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.noise.model import NoiseModel


@dataclass(frozen=True)
class Outliers:
    """The K samples that were filled, and their colours before."""

    samples: Int64s  # numbers among all samples of the surface
    channels: Bools  # the channels that were filled, shape (K, N)
    colours: Float32s  # shape (K, N)
    share: float  # of all samples


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilisedColours:
    """The colours of a manifold: without outliers, and with stabilised variance of the noise.

    Parameters and results are in units of the input's colours. `NoiseModel.to_input` converts colours back;
    `beta_to_input`, `difference_to_input` and `square_to_input` convert measurements.
    """

    stack: Stack
    noise: NoiseModel  # of the stack
    outliers: Outliers | None = None  # that were filled
