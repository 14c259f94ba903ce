"""Hashes of colours: random choices that do not depend on the order of vertices and channels, nor on rotation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Int32s
from beltrami_cli.surface import large_arrays

# Odd multipliers with well-mixed bits, as in SplitMix64, for hashing.
_MIXERS = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9], np.uint64)

# Steps of quantised colours per full scale, far above rounding.
_COARSE = np.float32(256)


def fingerprints(colours: Float32s, edges: Int32s) -> NDArray[np.uint64]:
    """Hash the colours of each sample, its neighbours and their neighbours; uint64, shape (S,)."""
    hashes = np.zeros(len(colours), np.uint64)
    # A sum is invariant to the order of channels and of neighbours.
    for channel in _bits(colours):
        hashes += _hashed(channel)
    for _ in range(2):
        around = np.zeros_like(hashes)
        for block in large_arrays.blocks(len(edges)):
            for this, other in ((0, 1), (1, 0)):
                np.add.at(around, edges[block, this], hashes[edges[block, other]])
        hashes = _hashed(_hashed(hashes) + around)
    return hashes


def random_signs(colours: Float32s, around: NDArray[np.uint64], count: int) -> Float32s:
    """Draw pseudo-random signs that depend only on nearby colours, shape (count, S, N); `count` <= 64."""
    signs: Float32s = large_arrays.empty((count, *colours.shape), np.float32)
    for block in large_arrays.blocks(len(colours)):
        for channel, values in enumerate(_bits(colours[block])):
            bits = _hashed(around[block] + _hashed(values))
            for probe in range(count):
                signs[probe, block, channel] = np.where(bits >> np.uint64(probe) & np.uint64(1), 1, -1)
    return signs


def quantised(colours: Float32s) -> Float32s:
    """Round colours, since hashes of colours that differ only by rounding must be equal."""
    steps = np.multiply(colours, _COARSE, dtype=np.float32)
    return np.round(steps, out=steps)


def _bits(colours: Float32s) -> Iterator[NDArray[np.uint64]]:
    """Return the bits of each channel's colours as integers, shape (S,)."""
    for channel in colours.T:
        yield np.ascontiguousarray(channel).view(np.uint32).astype(np.uint64)


def _hashed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Hash integers to well-mixed ones, modulo 2^64."""
    mixed: NDArray[np.uint64] = values + _MIXERS[0]
    mixed *= _MIXERS[1]
    mixed ^= mixed >> np.uint64(29)
    mixed *= _MIXERS[0]
    mixed ^= mixed >> np.uint64(32)
    return mixed
