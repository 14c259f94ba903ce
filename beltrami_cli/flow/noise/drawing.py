"""Drawing noise of a given covariance, on grids and on clusters of vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int8s
from beltrami_cli.flow.vertex_graph import Level
from beltrami_cli.surface import large_arrays

# Rows processed at a time where each needs temporary memory.
_BLOCK_ROWS = 64


def draw_on_grid(covariances: Float64s, shape: tuple[int, int], random: np.random.Generator) -> Float32s:
    """Draw noise, shape (N, *shape), of the given covariances of Haar details, shape (L, N, N)."""
    levels = len(covariances)
    noise = draw_white(covariances[-1], [-(-size // 2**levels) for size in shape], random)
    noise /= np.float32(2**levels)
    for level in reversed(range(levels)):
        details = [draw_white(covariances[level], noise.shape[1:], random) for _ in range(3)]
        noise = _with_details(noise, details, np.float32(2 ** (level + 1)))
    if noise.shape[1:] == shape:
        return noise
    cropped: Float32s = large_arrays.empty((len(noise), *shape), np.float32)
    for rows in large_arrays.blocks(shape[0], _BLOCK_ROWS):
        cropped[:, rows] = noise[:, rows, : shape[1]]
    return cropped


def _with_details(noise: Float32s, details: list[Float32s], size: np.float32) -> Float32s:
    """Upsample noise to twice as many rows and columns, and add details divided by `size`."""
    channels, rows, columns = noise.shape
    finer: Float32s = large_arrays.empty((channels, 2 * rows, 2 * columns), np.float32)
    cells = finer.reshape(channels, rows, 2, columns, 2)
    for block in large_arrays.blocks(rows, _BLOCK_ROWS):
        coarse = noise[:, block]
        across, down, both = (detail[:, block] / size for detail in details)
        cells[:, block, 0, :, 0] = coarse + across + down + both
        cells[:, block, 0, :, 1] = coarse - across + down - both
        cells[:, block, 1, :, 0] = coarse + across - down - both
        cells[:, block, 1, :, 1] = coarse - across - down + both
    return finer


def draw_white(covariance: Float64s, shape: Sequence[int], random: np.random.Generator) -> Float32s:
    """Draw white noise with a covariance of the channels, shape (N, *shape)."""
    root = root_of(covariance)
    signs = draw_signs((len(root), *shape), random)
    mixed: Float32s = large_arrays.empty(signs.shape, np.float32)
    for rows in large_arrays.blocks(shape[0], _BLOCK_ROWS):
        # Not with BLAS, whose idle threads keep spinning.
        mixed[:, rows] = np.einsum("ij,jrc->irc", root, signs[:, rows].astype(np.float32))
    return mixed


def draw_signs(shape: Sequence[int], random: np.random.Generator) -> Int8s:
    """Draw independent signs; the result does not depend on blocks, which are multiples of one draw."""
    signs: Int8s = large_arrays.empty(shape, np.int8)
    flat = signs.reshape(-1)
    for block in large_arrays.blocks(len(flat)):
        flat[block] = random.integers(0, 2, block.stop - block.start, np.int8) * 2 - 1
    return signs


def root_of(covariance: Float64s) -> Float32s:
    """Return the symmetric square root of a covariance."""
    values, vectors = np.linalg.eigh(covariance)
    root: Float32s = ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T).astype(np.float32)
    return root


def draw_on_clusters(covariances: Float64s, levels: Sequence[Level], signs: Float32s) -> Float32s:
    """Draw the same noise for vertices, shape (S, N), from independent signs of samples for each level."""
    noise: Float32s = np.zeros(signs.shape[1:], np.float32)
    for number, (level, of_level) in enumerate(zip(levels, signs, strict=True)):
        root = root_of(covariances[min(number, len(covariances) - 1)])
        drawn = np.einsum("ij,sj->si", root, of_level[level.centres]) / np.sqrt(level.counts)[:, None]
        if number + 1 < len(levels):  # details: differences from the mean of the next level
            above, weighted = levels[number + 1], drawn * level.counts[:, None]
            parents = above.members[level.centres]
            sums = np.stack([np.bincount(parents, column, above.graph.size) for column in weighted.T], axis=1)
            drawn -= (sums / above.counts[:, None])[parents].astype(np.float32)
        noise += drawn[level.members]
    return noise
