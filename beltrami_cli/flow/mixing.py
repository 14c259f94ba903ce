"""Decorrelation of channels for patches, so that each mixed channel can be estimated separately."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.noise.components import COMPONENTS

# Weight of channel differences when patches are compared: they hold little detail and as much noise.
_COMPARED = np.array([1, 0.5, 0.5])

# Factor of the noise variance in estimates with a pilot, where patches show no detail. In photographs most detail of
# channel differences is also in the mean, and their remaining noise is the visible part. Shared noise is known less
# well and may be larger than estimated, so its factor is never below 1.
_SHRINKAGE = {"mean": 2.0, "difference": 6.0, "shared by neighbours": 1.0}

# Channels are colours if their differences vary less than their mean by this factor.
_COLOURED = 0.7

# Noise of a channel, as a share of the largest, below which the channel is not estimated.
NOISELESS = 0.01

# Size of the perturbation in units of the noise. Groups of patches change with the colours in steps. A smaller
# perturbation misses these steps, so that patches are trusted too much where noise is underestimated; a larger one
# counts too many.
PATCH_PERTURBATION = 0.2


@dataclass(frozen=True)
class Mixing:
    """Linear mixing of N channels to decorrelated ones, shape (N, N), and their noise variance, shape (N,)."""

    forth: Float32s
    back: Float32s
    variances: Float32s
    shrinkage: Float32s  # shape (N,): factor of the noise with a pilot, where there is no detail
    least_ratio: float = 0.0  # lower bound of that factor where there is detail
    strength: float = 1.0  # further factor, everywhere
    has_pilot: bool = False  # patches are compared on an estimate

    @classmethod
    def of(cls, steps: Float32s, noise: Float64s) -> Mixing:
        """Mix colours to their mean and differences, and leave other channels as they are.

        `steps`: differences of colours between neighbours, shape (K, N), which show whether they are colours; `noise`:
        covariance of the channels.
        """
        count = len(noise)
        forth = np.eye(count)
        if count >= len(COMPONENTS) and _are_colours(steps):
            forth[:3, :3] = _COMPARED[:, None] * COMPONENTS
        mixed = np.einsum("ki,ij,kj->k", forth, noise, forth)
        # A floor for channels almost without noise; the added variance is invisible.
        np.maximum(mixed, NOISELESS**2 * mixed.max(initial=0), out=mixed)
        back = np.linalg.inv(forth).astype(np.float32)
        return cls(forth.astype(np.float32), back, mixed.astype(np.float32), np.ones(count, np.float32))

    def with_pilot(self, strength: float, *, is_shared: bool) -> Mixing:
        """Return the mixing for estimates that have a pilot; `is_shared`: neighbours share the noise."""
        is_mixed = np.count_nonzero(self.forth, axis=1) > 1
        is_difference = is_mixed & (self.forth.sum(axis=1) < self.forth.max(axis=1))
        shrinkage, least = np.where(is_difference, _SHRINKAGE["difference"], _SHRINKAGE["mean"]), 0.0
        if is_shared:
            least = _SHRINKAGE["shared by neighbours"]
            shrinkage = np.full(len(shrinkage), least)
        return dataclasses.replace(
            self, shrinkage=shrinkage.astype(np.float32), least_ratio=least, strength=strength, has_pilot=True
        )

    @property
    def parts(self) -> tuple[Float32s, Float32s, Float32s, Float32s, float, float]:
        """The fields, as the core takes them."""
        return self.forth, self.back, self.variances, self.shrinkage, self.least_ratio, self.strength


def _are_colours(steps: Float32s) -> bool:
    """Whether the first three channels vary mostly together."""
    mixed = np.square(np.einsum("kj,ij->ki", steps[:, :3].astype(np.float64), COMPONENTS)).sum(axis=0)
    return bool(mixed[1:].sum() <= 2 * _COLOURED * mixed[0])
