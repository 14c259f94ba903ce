"""The gutter: texels beside charts, which no face covers but which interpolated and mip-mapped lookups touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli._native import nearest_marked
from beltrami_cli.mesh import large_arrays

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
        first = max(0, band.start - reach)
        near = np.ascontiguousarray(covered[first : band.stop + reach])
        nearest = nearest_marked(near, reach, threads)[band.start - first :][: len(target)]
        target &= nearest >= 0
        rows, columns = np.divmod(nearest[target], covered.shape[1])
        for channel in range(pixels.shape[2]) if channels is None else channels:
            pixels[band, :, channel][target] = pixels[first + rows, columns, channel]
