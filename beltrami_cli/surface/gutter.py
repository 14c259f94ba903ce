"""The gutter: texels beside charts, which no face covers but which interpolated and mip-mapped lookups touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli._native import nearest_marked
from beltrami_cli.surface import large_arrays

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

# Rows of a texture that are looked at together.
_ROWS = 512


def fill_gutter(
    pixels: NDArray[Any],
    covered: NDArray[np.bool_],
    mask: NDArray[np.bool_] | None,
    width: int | None,
    known: NDArray[np.bool_] | None = None,
    threads: int = 1,
    channels: Sequence[int] | None = None,
    opacity: NDArray[np.float32] | None = None,
) -> None:
    """Give texels beside charts, in place, the colour of the nearest covered texel.

    Parameters
    ----------
    pixels : ndarray, shape (H, W, C)
        The texture, of any type.
    covered : ndarray of bool, shape (H, W)
        Texels that the surface covers. They keep their colours.
    mask : ndarray of bool, shape (H, W), or None
        Where the source had content: other texels keep theirs. None: everywhere.
    width : int or None
        How far from covered texels colours are filled in, in texels (Euclidean distance). None: however far.
    known : ndarray of bool, shape (H, W), or None
        Uncovered texels that have been given their colours already, from beyond a seam. They keep them.
    threads : int
        The result does not depend on it.
    channels : sequence of int, optional
        Which channels change; without it all.
    opacity : ndarray of float32, shape (H, W), optional
        What is multiplied into the colours, which are given that of the texel that they go to. Not 0 where covered.
    """
    reach = sum(covered.shape) if width is None else width
    for band in large_arrays.blocks(len(covered), max(_ROWS, reach)):
        target = ~covered[band]
        if known is not None:
            target &= ~known[band]
        if mask is not None:
            target &= mask[band]
        if not target.any():
            continue
        first, last = max(0, band.start - reach), band.stop + reach
        wanted = np.zeros(covered[first:last].shape, bool)
        wanted[band.start - first : band.stop - first] = target
        texels, nearest = nearest_marked(np.ascontiguousarray(covered[first:last]), wanted, reach, threads)
        table = pixels[first:last].reshape(-1, pixels.shape[2])
        share = None
        if opacity is not None:
            visible = opacity[first:last].reshape(-1)
            share = visible[texels] / visible[nearest]
        for channel in range(pixels.shape[2]) if channels is None else channels:
            found = table[nearest, channel]
            table[texels, channel] = found if share is None else _scaled(found, share)


def _scaled(colours: NDArray[Any], share: NDArray[np.float32]) -> NDArray[Any]:
    scaled = colours * share
    if colours.dtype.kind != "f":
        scaled = np.minimum(np.rint(scaled), np.iinfo(colours.dtype).max)
    return scaled.astype(colours.dtype)
