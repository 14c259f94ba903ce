"""Colours put among the pixels of a picture, in its type."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from beltrami_cli.formats.image.picture import as_stored
from beltrami_cli.samples.change import Change
from beltrami_cli.surface.colour_values import store_integers

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.image import Picture
    from beltrami_cli.surface.atlas import Indices


def store(
    picture: Picture,
    table: NDArray[Any],
    pixels: Indices,
    values: NDArray[np.float32],
    channels: Sequence[int],
    threads: int,
) -> Change:
    """Put values into pixels like a picture's, in place, each rounded once.

    Parameters
    ----------
    picture : Picture
        What the pixels are of.
    table : ndarray, shape (P, C)
        Pixels of the picture's type and channels.
    pixels : ndarray of int, shape (K,)
        Which of them change, each once.
    values : ndarray of float32, shape (K, M)
        New values, full scale 1. Beyond the range of the stored type they are clipped. Those that
        equal what is stored leave its bits as they are.
    channels : sequence of int
        The M channels that they are of.
    threads : int
        The result does not depend on it.

    Returns
    -------
    Change
        Of these K x M numbers, as they are stored.
    """
    if table.dtype.kind == "f":
        before = table[pixels[:, None], channels]
        for channel, old, new in zip(channels, before.T, values.T, strict=True):
            moved = new != old  # -0 stays what it is
            table[pixels[moved], channel] = as_stored(new[moved], picture.kinds[channel])
        return Change.between(before, table[pixels[:, None], channels])
    return Change(values.size, *store_integers(table, pixels, values, channels, threads))
