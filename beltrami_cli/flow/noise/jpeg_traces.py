"""Traces of JPEG in squares of a grid, shape (P, S, S), that are aligned with its blocks of 8 x 8 cells."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int64s
from beltrami_cli.flow.noise.components import log_deviation

# Cells per side of a block, its cosine basis, and the band of each coefficient, by the sum of both frequencies.
_BLOCK = 8
_COSINES = np.cos(np.pi / _BLOCK * (np.arange(_BLOCK) + 0.5) * np.arange(_BLOCK)[:, None]).astype(np.float32)
_COSINES *= np.sqrt(np.where(np.arange(_BLOCK) > 0, 2, 1) / _BLOCK).astype(np.float32)[:, None]
_BANDS: Int64s = np.digitize(np.add.outer(np.arange(_BLOCK), np.arange(_BLOCK)), (1, 3, 5, 8))

# Magnitude below which a coefficient of luma counts as 0: rounding to 8 bits gives coefficients a deviation of 0.2.
_ZERO_WAVE = 0.75

# Weights of red, green and blue in luma.
LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def block_steps(means: Float32s, filled: Bools) -> Float32s:
    """Return log2 of the ratio of steps at the borders of blocks to steps everywhere, shape (P,)."""
    excess = np.zeros(len(means), np.float32)
    for axis in (1, 2):
        both = np.moveaxis(filled, axis, -1)
        both = both[..., 1:] & both[..., :-1]
        jumps = np.square(np.diff(np.moveaxis(means, axis, -1), axis=-1)) * both
        for part, sign in ((np.s_[..., _BLOCK - 1 :: _BLOCK], 1), (np.s_[...], -1)):
            count = np.maximum(both[part].sum(axis=(1, 2)), 1)
            excess += sign * log_deviation(jumps[part].sum(axis=(1, 2)) / count)
    return excess


def coefficients(luma: Float32s, filled: Bools) -> list[Float32s]:
    """Return features of the cosine coefficients of 8 x 8 blocks by band; JPEG rounds these to multiples of a step.

    The features are the median magnitude, the lowest tenth of the nonzero magnitudes, which is close to the step, and
    the share of zeros.
    """
    blocks = luma.shape[-1] // _BLOCK
    shape = len(luma), blocks, _BLOCK, blocks, _BLOCK
    across = np.einsum("vj,paibj->paibv", _COSINES, luma.reshape(shape))
    waves = np.abs(np.einsum("ui,paibv->puvab", _COSINES, across))
    is_whole: Bools = np.asarray(filled.reshape(shape).all(axis=(2, 4)))
    features = []
    for band in range(1, _BANDS.max() + 1):  # band 0 is the mean of a block
        of_band = waves[:, band == _BANDS]
        of_band = np.where(is_whole[:, None], of_band, np.inf).reshape(len(luma), -1)
        ordered, known = np.sort(of_band, axis=1), np.isfinite(of_band).sum(axis=1)
        zeros = (of_band < _ZERO_WAVE).sum(axis=1)
        for rank in (known // 2, zeros + (known - zeros) // 10):
            ranks = np.minimum(rank, of_band.shape[1] - 1)[:, None]
            picked = np.take_along_axis(ordered, ranks, axis=1)[:, 0]
            features.append(log_deviation(np.square(np.where(np.isfinite(picked), picked, 0))))
        features.append(zeros / np.maximum(known, 1))
    return features
