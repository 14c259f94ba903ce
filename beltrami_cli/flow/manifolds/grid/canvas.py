"""The canvas of an atlas: colours to planes and back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.manifolds.grid.geometry import colours_at
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, refresh_halo


def on_canvas(atlas: Atlas, colours: Float32s) -> Float32s:
    """Put the colours of the owned cells, shape (T, N), on the canvas; see `fill_canvas`."""
    return fill_canvas(atlas, colours.shape[1], colours.__getitem__)


def fill_canvas(atlas: Atlas, channels: int, colours_of: Callable[[slice], Float32s]) -> Float32s:
    """Make planes, shape (N, R, C), with colours in owned and halo cells, and 0 in empty cells."""
    planes = large_arrays.zeros((channels, *atlas.kind.shape), np.float32)
    for block in large_arrays.blocks(len(atlas.owned_cells), large_arrays.CACHED):
        for plane, colours in zip(planes.reshape(channels, -1), colours_of(block).T, strict=True):
            plane[atlas.owned_cells[block]] = colours
    refresh_halo(planes, atlas)
    return planes


def canvas_colours(atlas: Atlas, planes: Float32s) -> NewColours:
    """Return the colours of owned cells, read from the planes on demand, and of the gutter."""
    gutter, halo = atlas.gutter, atlas.halo
    beyond = np.zeros((len(gutter.cells), len(planes)), np.float32)
    for block in large_arrays.blocks(len(beyond), large_arrays.SCATTERED):
        rank = np.searchsorted(halo.cells, gutter.cells[block])
        taps, weights = halo.taps[rank], halo.weights[rank]
        for channel, plane in enumerate(planes.reshape(len(planes), -1)):
            beyond[block, channel] = np.einsum("ht,ht->h", plane[taps], weights)
    return NewColours(
        lambda block, inside: colours_at(planes, atlas.owned_cells[block][inside]),
        atlas.owned_texels,
        gutter.texels,
        beyond,
    )
