"""Noise that neighbouring samples share, as covariances of its Haar details, scale by scale.

The Haar transform splits a grid into the details of single cells, of means of 2 x 2 cells, of 4 x 4, and so on [1]_; on
meshes clusters of some four vertices stand for squares. Independent noise has the same variance in all of them. Noise
that was stored, scaled or compressed has less in the finer ones, and channels share it. Covariances have the shape
(L, N, N): of N channels in the details of single samples, of means of some four and so on, the last for all coarser
ones, in units in which they are equal for independent noise.

References
----------
.. [1] S. Mallat, "A theory for multiresolution signal decomposition: the wavelet representation", IEEE Trans. Pattern
   Analysis and Machine Intelligence 11(7), 1989, doi:10.1109/34.192463
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.vertex_graph import Level
from beltrami_cli.surface import large_arrays

# Rows that are worked on at a time, where each needs memory.
_ROWS = 64


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
    noise = mixed_signs(covariances[-1], [-(-size // 2**levels) for size in shape], random)
    noise /= np.float32(2**levels)
    for level in reversed(range(levels)):
        details = [mixed_signs(covariances[level], noise.shape[1:], random) for _ in range(3)]
        noise = _with_details(noise, details, np.float32(2 ** (level + 1)))
    if noise.shape[1:] == shape:
        return noise
    cropped: Float32s = large_arrays.empty((len(noise), *shape), np.float32)
    for rows in large_arrays.blocks(shape[0], _ROWS):
        cropped[:, rows] = noise[:, rows, : shape[1]]
    return cropped


def _with_details(noise: Float32s, details: list[Float32s], size: np.float32) -> Float32s:
    """Return noise on twice as many rows and columns, with details divided by a size."""
    channels, rows, columns = noise.shape
    finer: Float32s = large_arrays.empty((channels, 2 * rows, 2 * columns), np.float32)
    cells = finer.reshape(channels, rows, 2, columns, 2)
    for block in large_arrays.blocks(rows, _ROWS):
        own = noise[:, block]
        across, down, both = (detail[:, block] / size for detail in details)
        cells[:, block, 0, :, 0] = own + across + down + both
        cells[:, block, 0, :, 1] = own - across + down - both
        cells[:, block, 1, :, 0] = own + across - down - both
        cells[:, block, 1, :, 1] = own - across - down + both
    return finer


def mixed_signs(covariance: Float64s, shape: Sequence[int], random: np.random.Generator) -> Float32s:
    """Draw white noise with a covariance of the channels, shape (N, *shape)."""
    root = root_of(covariance)
    signs = large_arrays.random_signs((len(root), *shape), random)
    mixed: Float32s = large_arrays.empty(signs.shape, np.float32)
    for rows in large_arrays.blocks(shape[0], _ROWS):
        # Not by BLAS, whose threads would spin on.
        mixed[:, rows] = np.einsum("ij,jrc->irc", root, signs[:, rows].astype(np.float32))
    return mixed


def root_of(covariance: Float64s) -> Float32s:
    """Return the symmetric root of a covariance."""
    values, vectors = np.linalg.eigh(covariance)
    root: Float32s = ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T).astype(np.float32)
    return root


def draw_noise_of_clusters(covariances: Float64s, levels: Sequence[Level], signs: Float32s) -> Float32s:
    """Draw the same on clusters, from single samples on, by independent signs of samples for each level."""
    noise: Float32s = np.zeros(signs.shape[1:], np.float32)
    for number, (level, own) in enumerate(zip(levels, signs, strict=True)):
        root = root_of(covariances[min(number, len(covariances) - 1)])
        drawn = np.einsum("ij,sj->si", root, own[level.centres]) / np.sqrt(level.counts)[:, None]
        if number + 1 < len(levels):  # details are what differs from the mean of the next level
            above, held = levels[number + 1], drawn * level.counts[:, None]
            parents = above.members[level.centres]
            sums = np.stack([np.bincount(parents, column, above.graph.size) for column in held.T], axis=1)
            drawn -= (sums / above.counts[:, None])[parents].astype(np.float32)
        noise += drawn[level.members]
    return noise
