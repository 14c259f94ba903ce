"""What the core is told of each cell of a canvas, besides how far it is from its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface import large_arrays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.surface.atlas import Atlas

# Rows and columns about a halo cell in which others are looked for that show the same texel: those of a chart that is
# up to seven times as fine as what it is continued by.
_REPEATS_REACH = 3

# Rows that are looked at together.
_ROWS = 256


@dataclass(frozen=True)
class CellFields:
    """Values of the R x C cells of a canvas, or of some of them.

    Attributes
    ----------
    scale : ndarray of float32, shape (R, C), or None
        What squared lengths are multiplied by, to be in the local unit of length; None: 1.
    repeats : ndarray of uint8, shape (R, C), or None
        How many cells show the same texel as a halo cell does, each of which counts in averages for one over that many;
        None: 1. Else a chart that is finer than what it is continued by would draw its averages to single noisy texels.
    """

    scale: NDArray[np.float32] | None
    repeats: NDArray[np.uint8] | None

    def at(self, cells: NDArray[np.int64]) -> CellFields:
        """Return the values at flat indices of any shape."""
        return CellFields(
            None if self.scale is None else np.ascontiguousarray(self.scale.reshape(-1)[cells]),
            None if self.repeats is None else np.ascontiguousarray(self.repeats.reshape(-1)[cells]),
        )

    def rows(self, rows: slice) -> CellFields:
        """Return the values of some rows, one after the other."""
        return CellFields(
            None if self.scale is None else self.scale[rows],
            None if self.repeats is None else self.repeats[rows],
        )


def local_scales(atlas: Atlas, window: int) -> NDArray[np.float32]:
    """Tell by what squared lengths are multiplied, to be in units of the sample spacing around each cell.

    Parameters
    ----------
    atlas : Atlas
        The canvas.
    window : int
        Rows and columns over which the spacing is taken.

    Returns
    -------
    ndarray of float32, shape (R, C)
    """
    from beltrami_cli._native import local_scale

    rows, reach = atlas.kind.shape[0], window // 2
    scales = large_arrays.empty(atlas.kind.shape, np.float32)
    for band in large_arrays.blocks(rows, _ROWS):
        first = max(0, band.start - reach)
        right, below = atlas.squared_lengths[:2, first : band.stop + reach]
        scales[band] = local_scale(right, below, reach)[band.start - first : band.stop - first]
    return scales


def halo_repeats(atlas: Atlas, threads: int) -> NDArray[np.uint8] | None:
    """Count how often texels are shown beyond seams.

    Parameters
    ----------
    atlas : Atlas
        The canvas.
    threads : int
        Threads to use.

    Returns
    -------
    ndarray of uint8, shape (R, C), or None
        See `CellFields`; None if no texel is shown more than once.
    """
    from beltrami_cli._native import halo_repeats as count

    if not len(atlas.halo_cells):
        return None
    cells, sources = (np.ascontiguousarray(of, np.int64) for of in (atlas.halo_cells, atlas.halo_nearest))
    rows, columns = atlas.kind.shape
    repeats = count(rows, columns, cells, sources, atlas.halo_seams, _REPEATS_REACH, threads)
    return repeats if repeats.max(initial=1) > 1 else None
