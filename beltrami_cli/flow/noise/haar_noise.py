"""Noise that neighbouring cells of a grid share, as covariances of its Haar details, scale by scale.

The Haar transform splits a grid into the details of single cells, of means of 2 x 2 cells, of 4 x 4, and so on [1]_.
Independent noise has the same variance in all of them. Noise that was stored, scaled or compressed has less in the
finer ones, and channels share it. Covariances have the shape (L, N, N): of N channels in the details of single cells,
of 2 x 2 cells and so on, the last for all coarser ones, in units in which they are equal for independent noise.

References
----------
.. [1] S. Mallat, "A theory for multiresolution signal decomposition: the wavelet representation", IEEE Trans. Pattern
   Analysis and Machine Intelligence 11(7), 1989, doi:10.1109/34.192463
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float32s, Float64s


def covariance_of_cells(covariances: Float64s) -> Float64s:
    """Return the covariance of the noise of single cells, shape (N, N), from those of shape (L, N, N)."""
    # Three quarters of independent noise are detail, and one quarter is in the means of 2 x 2 cells.
    shares = 3 / 4.0 ** np.arange(1, len(covariances) + 1)
    shares[-1] += 1 / 4.0 ** len(covariances)
    total: Float64s = np.einsum("l,lij->ij", shares, covariances)
    return total


def sigma_of_covariances(covariances: Float64s) -> Float64s:
    """Return sigma of the noise of single cells, per channel, from covariances of shape (L, N, N)."""
    return np.sqrt(np.diag(covariance_of_cells(covariances)))


def draw_haar_noise(covariances: Float64s, shape: tuple[int, int], random: np.random.Generator) -> Float32s:
    """Draw noise, shape (N, *shape), of the given covariances of Haar details, shape (L, N, N)."""
    levels = len(covariances)
    coarse = [-(-size // 2**levels) for size in shape]
    noise = mixed_signs(covariances[-1], coarse, random) / np.float32(2**levels)
    for level in reversed(range(levels)):
        rows, columns = noise.shape[1:]
        across, down, both = (
            mixed_signs(covariances[level], (rows, columns), random) / np.float32(2 ** (level + 1))
            for _ in range(3)
        )
        finer = np.empty((len(noise), rows, 2, columns, 2), np.float32)
        finer[:, :, 0, :, 0] = noise + across + down + both
        finer[:, :, 0, :, 1] = noise - across + down - both
        finer[:, :, 1, :, 0] = noise + across - down - both
        finer[:, :, 1, :, 1] = noise - across - down + both
        noise = finer.reshape(len(noise), 2 * rows, 2 * columns)
    return np.ascontiguousarray(noise[:, : shape[0], : shape[1]])


def mixed_signs(
    covariance: Float64s, shape: list[int] | tuple[int, ...], random: np.random.Generator
) -> Float32s:
    """Draw white noise with a covariance of the channels, shape (N, *shape)."""
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    signs = (random.integers(0, 2, (len(root), *shape), np.int8) * 2 - 1).astype(np.float32)
    # Not by BLAS, whose threads would spin on.
    mixed: Float32s = np.einsum("ij,jrc->irc", root.astype(np.float32), signs)
    return mixed
