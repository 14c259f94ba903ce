"""Pixels of pictures with some numbers stored anew."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.layers.layer import store

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.image import Picture


def repainted(picture: Picture, values: NDArray[np.float32], changed: NDArray[np.bool_]) -> NDArray[Any]:
    """Return the pixels of a picture with some numbers stored anew."""
    pixels = picture.pixels.copy()
    table, wanted = pixels.reshape(-1, pixels.shape[2]), changed.reshape(-1, pixels.shape[2])
    for channel, rows in enumerate(map(np.flatnonzero, wanted.T)):
        new = values.reshape(table.shape)[rows, channel, None]
        store(picture, table, rows, new, [channel], threads=1)
    return pixels
