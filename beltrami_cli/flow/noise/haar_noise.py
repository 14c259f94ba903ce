"""Noise that neighbouring cells of a grid have in common, octave by octave.

The Haar transform takes a grid apart into the details of single cells, of means of 2 x 2 cells, of 4 x 4, and so on
[1]_. Noise that is independent has the same variance in all of them. What was stored, scaled or compressed before has
less in the finer ones, and channels share it.

References
----------
.. [1] S. Mallat, "A theory for multiresolution signal decomposition: the wavelet representation", IEEE Trans. Pattern
   Analysis and Machine Intelligence 11(7), 1989, doi:10.1109/34.192463
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def sigma_of_octaves(octaves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation of the noise of single cells, per channel.

    Parameters
    ----------
    octaves : ndarray of float64, shape (L, N, N)
        Covariances of the channels, see `draw_octaves`.

    Returns
    -------
    ndarray of float64, shape (N,)
    """
    variances = np.diagonal(octaves, axis1=1, axis2=2)
    # Of independent noise, three quarters are detail, and one is in the means of 2 x 2 cells.
    shares = 3 / 4.0 ** np.arange(1, len(octaves) + 1)
    total: NDArray[np.float64] = shares @ variances + variances[-1] / 4.0 ** len(octaves)
    return np.sqrt(total)


def draw_octaves(
    octaves: NDArray[np.float64], shape: tuple[int, int], random: np.random.Generator
) -> NDArray[np.float32]:
    """Draw noise of some covariances.

    Parameters
    ----------
    octaves : ndarray of float64, shape (L, N, N)
        Covariances of the channels in the details of single cells, of 2 x 2 cells and so on, the last for all that are
        coarser; in units by which they are equal for independent noise.
    shape : (int, int)
        Rows and columns.
    random : numpy.random.Generator
        Source of signs.

    Returns
    -------
    ndarray of float32, shape (N, *shape)
    """
    levels = len(octaves)
    coarse = [-(-size // 2**levels) for size in shape]
    noise = _mixed(octaves[-1], coarse, random) / np.float32(2**levels)
    for level in reversed(range(levels)):
        rows, columns = noise.shape[1:]
        across, down, both = (
            _mixed(octaves[level], (rows, columns), random) / np.float32(2 ** (level + 1)) for _ in range(3)
        )
        finer = np.empty((len(noise), rows, 2, columns, 2), np.float32)
        finer[:, :, 0, :, 0] = noise + across + down + both
        finer[:, :, 0, :, 1] = noise - across + down - both
        finer[:, :, 1, :, 0] = noise + across - down - both
        finer[:, :, 1, :, 1] = noise - across - down + both
        noise = finer.reshape(len(noise), 2 * rows, 2 * columns)
    return np.ascontiguousarray(noise[:, : shape[0], : shape[1]])


def _mixed(
    covariance: NDArray[np.float64], shape: list[int] | tuple[int, int], random: np.random.Generator
) -> NDArray[np.float32]:
    """Draw white noise of a covariance of the channels, shape (N, *shape)."""
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    signs = (random.integers(0, 2, (len(root), *shape), np.int8) * 2 - 1).astype(np.float32)
    # Not by BLAS, whose threads spin on.
    mixed: NDArray[np.float32] = np.einsum("ij,jrc->irc", root.astype(np.float32), signs)
    return mixed
