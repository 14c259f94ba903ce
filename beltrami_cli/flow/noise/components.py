"""Colours as components, and the variances and covariances of their details.

The components of three channels are their mean and two differences, which are orthonormal. Covariances of N channels
have the shape (L, N, N), see `model`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s

# Number of scales of details that are described.
SCALES = 4

# The mean of three channels and two differences, orthonormal.
COMPONENTS = (np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])).astype(np.float32)

# Pairs of components whose products are averaged. Squares come first.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

# Weights by which products of component pairs add up to the square of each channel.
_OF_CHANNELS = np.stack([COMPONENTS[k] * COMPONENTS[m] * (1 if k == m else 2) for k, m in PAIRS])

# Number of 8-bit steps in full scale.
STEPS = np.float32(255)

# Energy that is added before a logarithm is taken, in squared 8-bit steps. Noise of this energy is invisible in 8 bits.
FLOOR = 0.01

# Deviation that is added before a logarithm is read, in 8-bit steps. Rounding to 8 bits has a deviation of 0.29.
OFFSET = 0.3

# Energy below which a cell is constant, in squared 8-bit steps. The smallest squared detail of 8-bit images is 1 / 4.
CONSTANT = 0.01


def in_components(channels: Array) -> Array:
    """Transform channels, the first axis, to components."""
    return np.asarray(np.einsum("kc,c...->k...", COMPONENTS.astype(channels.dtype), channels))


def symmetric(products: Array) -> Array:
    """Return symmetric matrices, shape (..., 3, 3), from products of `PAIRS`, shape (..., 6)."""
    matrices = np.empty((*products.shape[:-1], 3, 3), products.dtype)
    for number, (one, other) in enumerate(PAIRS):
        matrices[..., one, other] = matrices[..., other, one] = products[..., number]
    return matrices


def variances_of_channels(products: Float32s) -> Float32s:
    """Return the variances of channels from the mean products of components, shape (P, 6)."""
    return np.asarray(np.einsum("pk,kc->pc", products, _OF_CHANNELS), np.float32)


def correlations_of_components(products: Float32s) -> Float32s:
    """Return the correlations of three components from their mean products, shape (P, 6)."""
    deviations = np.sqrt(products[:, :3] + FLOOR)
    pairs = PAIRS[3:]
    both = np.stack([deviations[:, k] * deviations[:, m] for k, m in pairs], axis=1)
    return np.asarray(products[:, 3:] / both, np.float32)


def log_deviation(variance: Array | float) -> Float32s:
    """Return log2 of the deviation for a variance in squared 8-bit steps, with a floor far below one step."""
    return np.asarray(np.log2(np.maximum(variance, 0) + FLOOR) / 2, np.float32)


def log_reading(variance: Array | float) -> Array:
    """Return log2(deviation + OFFSET), which the network reads, for a variance in squared 8-bit steps."""
    return np.asarray(np.log2(np.sqrt(np.maximum(variance, 0)) + OFFSET))


def log_quantiles(energies: Float32s, shares: Sequence[float]) -> list[Float32s]:
    """Return quantiles of the finite energies along the last axis, as logarithms of deviations."""
    ordered = np.sort(energies, axis=-1)
    last = np.isfinite(ordered).sum(axis=-1, keepdims=True) - 1
    ranks = np.maximum(np.rint(np.array(shares) * last), 0).astype(np.intp)
    picked = np.take_along_axis(ordered, ranks, axis=-1)
    return list(np.moveaxis(log_deviation(np.where(np.isfinite(picked), picked, 0)), -1, 0))


def covariance_of_cells(covariances: Float64s) -> Float64s:
    """Return the covariance of single cells' noise, shape (N, N), from that of each scale, shape (L, N, N)."""
    # Three quarters of independent noise are in details, and one quarter in the means of 2 x 2 cells.
    shares = 3 / 4.0 ** np.arange(1, len(covariances) + 1)
    shares[-1] += 1 / 4.0 ** len(covariances)
    total: Float64s = np.einsum("l,lij->ij", shares, covariances)
    return total


def sigma_of_covariances(covariances: Float64s) -> Float64s:
    """Return sigma of single cells' noise, per channel, from covariances of shape (L, N, N)."""
    return np.sqrt(np.maximum(np.diag(covariance_of_cells(covariances)), 0))
