"""Colours among integers: rounded, and how far these move."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.surface.atlas import Indices


def store_integers(
    table: NDArray[Any],
    pixels: Indices,
    values: NDArray[np.float32],
    channels: Sequence[int],
    threads: int,
) -> tuple[float, float, float]:
    """Put values into pixels of integers, in place, each rounded once.

    Parameters
    ----------
    table : ndarray of uint8 or uint16, shape (P, C)
        The pixels.
    pixels : ndarray of int, shape (K,)
        Which of them change, each once.
    values : ndarray of float32, shape (K, M)
        New values, full scale 1. What is beyond is clipped; what is no number becomes 0.
    channels : sequence of int
        The M channels that they are of.
    threads : int
        The result does not depend on it.

    Returns
    -------
    total, squares, largest : float
        Of the K x M changes, full scale 1: their sum, the sum of their squares, and the largest.
    """
    from beltrami_cli._native import store_colours

    rows, columns = np.ascontiguousarray(values), np.array(channels, np.int32)
    total, squares, largest = store_colours(table, pixels, rows, columns, threads)
    one = float(np.iinfo(table.dtype).max)
    return total / one, squares / one**2, largest / one
