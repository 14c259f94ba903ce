"""The gutter: texels beside charts, which no face covers but which interpolated and mip-mapped lookups touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli._native import nearest_marked

if TYPE_CHECKING:
    from numpy.typing import NDArray


def fill_gutter(
    pixels: NDArray[Any],
    covered: NDArray[np.bool_],
    mask: NDArray[np.bool_] | None,
    width: int | None,
    known: NDArray[np.bool_] | None = None,
    threads: int = 1,
) -> NDArray[Any]:
    """Give texels beside charts the colour of the nearest covered texel.

    Parameters
    ----------
    pixels : ndarray, shape (H, W, C)
        The texture, of any type; not changed.
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

    Returns
    -------
    ndarray, shape (H, W, C)
        A new texture of the same type.
    """
    filled = pixels.copy()
    target = ~covered
    if known is not None:
        target &= ~known
    if mask is not None:
        target &= mask
    if not covered.any() or not target.any() or width == 0:
        return filled
    reach = sum(covered.shape) if width is None else width
    nearest = nearest_marked(np.ascontiguousarray(covered), reach, threads)
    target &= nearest >= 0
    rows, columns = np.divmod(nearest[target], covered.shape[1])
    filled[target] = pixels[rows, columns]
    return filled
