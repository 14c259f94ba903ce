"""The canvas of an atlas: colours put on it and taken from there, and what the core knows of its cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas, Indices


# Rows and columns about a halo cell in which others are looked for that show the same texel: those of a chart that is
# up to seven times as fine as what it is continued by.
_REPEATS_REACH = 3

# Rows that are looked at together.
_ROWS = 256

# Cells whose colours are put on the canvas at a time: so few that they are still in the cache.
_BLOCK = 1 << 16


def painted(atlas: Atlas, colours: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
    """Put the colours of the owned cells, shape (T, N), on the canvas; see `painted_by`."""
    return painted_by(atlas, colours.shape[1], colours.__getitem__, threads)


def painted_by(
    atlas: Atlas, channels: int, colours_of: Callable[[slice], NDArray[np.float32]], threads: int
) -> NDArray[np.float32]:
    """Put the colours of owned cells on the canvas.

    Parameters
    ----------
    atlas : Atlas
        The canvas.
    channels : int
        How many each has.
    colours_of : callable
        Gives the colours of some of the T owned cells, shape (K, N).
    threads : int
        The result does not depend on it.

    Returns
    -------
    ndarray of float32, shape (N, R, C)
        Halo included; 0 elsewhere.
    """
    from beltrami_cli._native import scatter_colours

    planes = large_arrays.zeros((channels, *atlas.kind.shape), np.float32)
    for block in large_arrays.blocks(len(atlas.owned_cells), _BLOCK):
        scatter_colours(planes, atlas.owned_cells[block], colours_of(block), threads)
    refresh_halo(planes, atlas)
    return planes


def colours_at(planes: NDArray[np.float32], cells: Indices, threads: int) -> NDArray[np.float32]:
    """Return the colours of K cells (flat indices, each once), shape (K, N), from planes of shape (N, R, C)."""
    from beltrami_cli._native import gather_colours

    colours = large_arrays.empty((len(cells), len(planes)), np.float32)
    for block in large_arrays.blocks(len(cells)):
        gather_colours(planes, cells[block], colours[block], threads)
    return colours


def canvas_margin(parameters: KernelParameters) -> int:
    """Return how many cells beyond a chart its kernels look at."""
    blurred = guide_radius(parameters.metric_scale) if parameters.metric_steps else 0
    return parameters.window // 2 + blurred


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
