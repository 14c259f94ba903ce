"""The record of a texture atlas as a manifold: every chart on a canvas of its own, continued over its seams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

EMPTY, OWNED, HALO = 0, 1, 2


@dataclass(frozen=True)
class Atlas:
    """Charts laid out on one canvas of R x C cells, so that cells next to each other are so on the surface.

    A cell is OWNED where it is the place of a texel: each covered texel of the textures is one owned cell. It is
    HALO where it continues a chart beyond a seam (or stands for a texel that another cell owns): its colour comes from
    owned cells elsewhere. Everything else is EMPTY, which nothing crosses.

    Attributes
    ----------
    kind : ndarray of uint8, shape (R, C)
        EMPTY, OWNED or HALO. A margin as wide as the halo is EMPTY or HALO on all sides.
    squared_lengths : ndarray of float32, shape (4, R, C)
        Squared distance in space, in the surface's own unit, from the cell to its neighbour on the right, below, below
        right, and below left. Where either cell is EMPTY, or the neighbour lies outside: infinity.
    owned_cells : ndarray of int64, shape (T,)
        Flat indices of the owned cells, ascending.
    owned_texels : ndarray of int64, shape (T,)
        The texel of each: offset of its texture plus row * width + column.
    texture_offsets : ndarray of int64, shape (number of textures + 1,)
        Texels of texture i are numbered from its offset, row by row.
    halo_cells : ndarray of int64, shape (H,)
        Flat indices of the halo cells, ascending.
    halo_taps : ndarray of int64, shape (H, 4)
        Owned cells (flat indices) from which the halo cell's colour is interpolated.
    halo_weights : ndarray of float32, shape (H, 4)
        Their weights, not negative, with the sum 1.
    halo_seams : ndarray of int32, shape (H,)
        The seam over which the cell was reached, or -1 (no seam: the cell stands for a texel owned elsewhere).
    chart_of : ndarray of int32, shape (T,)
        Chart of each owned cell.
    charts, seams, seam_edges : int
        How many; a seam is a run of seam edges between the same two charts (or of a chart with itself).
    covered, overlapped : int
        Texels covered by the surface, and of these the texels covered more than once.
    """

    kind: NDArray[np.uint8]
    squared_lengths: NDArray[np.float32]
    owned_cells: NDArray[np.int64]
    owned_texels: NDArray[np.int64]
    texture_offsets: NDArray[np.int64]
    halo_cells: NDArray[np.int64]
    halo_taps: NDArray[np.int64]
    halo_weights: NDArray[np.float32]
    halo_seams: NDArray[np.int32]
    chart_of: NDArray[np.int32]
    charts: int
    seams: int
    seam_edges: int
    covered: int
    overlapped: int
