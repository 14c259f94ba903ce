"""The record of a whole mesh with one texture, for writing it as a new file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.surface.textured import ImageFile


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh with one texture.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Vertex positions.
    faces : ndarray of int32, shape (F, 3)
        Triangles, at least one.
    uv : ndarray of float64, shape (F, 3, 2)
        Texture coordinates of every corner in [0, 1]: u to the right, v down, as in `TexturedSurface`.
    image : ImageFile
        The texture.
    transparent : bool
        Whether its alpha is to be seen.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    uv: NDArray[np.float64]
    image: ImageFile
    transparent: bool = False


def distinct_corners(*columns: NDArray[np.generic]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the distinct rows of a table and number them by the order of their values.

    Parameters
    ----------
    *columns : ndarray, shape (K,)
        The table.

    Returns
    -------
    first : ndarray of int, shape (N,)
        A row of each number.
    number_of : ndarray of int, shape (K,)
        Number of each row.
    """
    order = np.lexsort(columns[::-1])
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in columns:
        new[1:] |= column[order][1:] != column[order][:-1]
    number_of = np.empty(len(order), np.intp)
    number_of[order] = np.cumsum(new) - 1
    return order[new], number_of
