"""Channels as patches take them: mixed so that each can be estimated by itself."""

from __future__ import annotations

import dataclasses

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.manifolds.domain import ENOUGH_STEPS, Mixing
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.noise.features import COMPONENTS

# Differences of channels count half when patches are compared, since they hold little detail and as much noise.
_COMPARED = np.array([1, 0.5, 0.5])

# What the noise is multiplied by, once there is a pilot, where patches show no detail. In photographs most detail of
# differences of channels is in their mean, too, and what remains of their noise is what people see. Noise that
# neighbours share is known less well, and what exceeds it may be noise as well: it is never multiplied by less.
_SHRINKAGE = {"mean": 2.0, "difference": 6.0, "shared by neighbours": 1.0}

# Channels whose differences vary this much less than their mean are colours.
_COLOURED = 0.7

# Noise of a channel, as a share of the largest, below which there is nothing to estimate.
NOISELESS = 0.01

# The perturbation, in units of the noise. Groups change with the colours in steps, which a smaller one does not see, so
# that patches are trusted too much where noise is underestimated; a larger one sees too much of them.
PERTURBATION = 0.2


def mixing_of(manifold: Manifold, colours: Float32s, noise: Float64s) -> Mixing:
    """Return how channels with a covariance of noise are mixed: colours by their mean and differences."""
    count = len(noise)
    forth = np.eye(count)
    if count >= len(COMPONENTS) and _is_coloured(manifold, colours):
        forth[:3, :3] = _COMPARED[:, None] * COMPONENTS
    mixed = np.einsum("ki,ij,kj->k", forth, noise, forth)
    # Where there is next to no noise, that little more is none that anyone sees.
    np.maximum(mixed, NOISELESS**2 * mixed.max(initial=0), out=mixed)
    parts = forth, np.linalg.inv(forth), mixed, np.ones(count)
    own, back, variances, shrinkage = (np.ascontiguousarray(part, np.float32) for part in parts)
    return Mixing(own, back, variances, shrinkage)


def with_pilot(mixing: Mixing, manifold: Manifold) -> Mixing:
    """Return the same for estimates with a pilot."""
    is_mixed = np.count_nonzero(mixing.forth, axis=1) > 1
    is_difference = is_mixed & (mixing.forth.sum(axis=1) < mixing.forth.max(axis=1))
    shrinkage, least = np.where(is_difference, _SHRINKAGE["difference"], _SHRINKAGE["mean"]), 0.0
    if manifold.noise.is_shared:
        least = _SHRINKAGE["shared by neighbours"]
        shrinkage = np.full(len(shrinkage), least)
    return dataclasses.replace(
        mixing,
        shrinkage=shrinkage.astype(np.float32),
        least_ratio=least,
        strength=manifold.parameters.strength,
        has_pilot=True,
    )


def _is_coloured(manifold: Manifold, colours: Float32s) -> bool:
    """Whether the first three channels vary mostly together."""
    steps = manifold.geometry.steps(colours)
    some = steps[:: 1 + len(steps) // ENOUGH_STEPS, :3].astype(np.float64)
    mixed = np.square(np.einsum("kj,ij->ki", some, COMPONENTS)).sum(axis=0)
    return bool(mixed[1:].sum() <= 2 * _COLOURED * mixed[0])
