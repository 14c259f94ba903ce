"""Colours of samples, put on the canvas of an atlas and taken from there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.surface.atlas import Atlas, Indices


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
    from beltrami_cli._native import put_colours

    planes = large_arrays.zeros((channels, *atlas.kind.shape), np.float32)
    for block in large_arrays.blocks(len(atlas.owned_cells), _BLOCK):
        put_colours(planes, atlas.owned_cells[block], colours_of(block), threads)
    refresh_halo(planes, atlas)
    return planes


def colours_at(planes: NDArray[np.float32], cells: Indices, threads: int) -> NDArray[np.float32]:
    """Return the colours of K cells (flat indices, each once), shape (K, N), from planes of shape (N, R, C)."""
    from beltrami_cli._native import take_colours

    colours = large_arrays.empty((len(cells), len(planes)), np.float32)
    for block in large_arrays.blocks(len(cells)):
        take_colours(planes, cells[block], colours[block], threads)
    return colours
