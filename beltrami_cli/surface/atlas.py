"""The record of a texture atlas as a manifold: every chart on a canvas of its own, continued over its seams."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from beltrami_cli.surface import large_arrays

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    # int32 in atlases of textures, which halves the memory for them.
    Indices: TypeAlias = NDArray[np.signedinteger[Any]]

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
        right, and below left. Infinite where the neighbour lies outside, and where the surface ends between the two
        (at an open edge, or between two parts of a chart that only touch in the image); without meaning where either
        is EMPTY.
    cut_cells : ndarray of int32 or int64, shape (K,)
        Flat indices, ascending, of the cells between which and a neighbour, not EMPTY, the surface ends at an edge.
    owned_cells : ndarray of int32 or int64, shape (T,)
        Flat indices of the owned cells, ascending.
    owned_texels : ndarray of int32 or int64, shape (T,)
        The texel of each: offset of its texture plus row * width + column.
    texture_offsets : ndarray of int64, shape (number of textures + 1,)
        Texels of texture i are numbered from its offset, row by row.
    halo_cells : ndarray of int32 or int64, shape (H,)
        Flat indices of the halo cells, ascending.
    halo_taps : ndarray of int32 or int64, shape (H, 4)
        Owned cells (flat indices) from which the halo cell's colour is interpolated.
    halo_weights : ndarray of float32, shape (H, 4)
        Their weights, not negative, with the sum 1.
    halo_seams : ndarray of int32, shape (H,)
        The seam over which the cell was reached, or -1 (no seam: the cell stands for a texel owned elsewhere).
    gutter_cells : ndarray of int32 or int64, shape (G,)
        Halo cells (flat indices) that stand on a texel that nothing covers.
    gutter_texels : ndarray of int32 or int64, shape (G,)
        That texel, each at most once: what a lookup just beyond a chart's border should see.
    chart_of : ndarray of int32, shape (T,)
        Chart of each owned cell.
    charts, seams, seam_edges : int
        How many; a seam is a run of seam edges between the same two charts (or of a chart with itself).
    covered, overlapped : int
        Texels covered by the surface, and of these the texels covered more than once.
    """

    kind: NDArray[np.uint8]
    squared_lengths: NDArray[np.float32]
    cut_cells: Indices
    owned_cells: Indices
    owned_texels: Indices
    texture_offsets: NDArray[np.int64]
    halo_cells: Indices
    halo_taps: Indices
    halo_weights: NDArray[np.float32]
    halo_seams: NDArray[np.int32]
    gutter_cells: Indices
    gutter_texels: Indices
    chart_of: NDArray[np.int32]
    charts: int
    seams: int
    seam_edges: int
    covered: int
    overlapped: int

    @cached_property
    def halo_nearest(self) -> Indices:
        """The owned cell nearest to the place of each halo cell, shape (H,)."""
        nearest = self.halo_weights.argmax(axis=1)
        return np.take_along_axis(self.halo_taps, nearest[:, None], axis=1)[:, 0]


def texels_by_texture(
    offsets: NDArray[np.int64], texels: Indices
) -> Iterator[tuple[int, NDArray[np.bool_] | slice, Indices]]:
    """Go through the textures that some texels are of.

    Parameters
    ----------
    offsets : ndarray of int64, shape (number of textures + 1,)
        As in `Atlas`.
    texels : ndarray of int, shape (K,)
        As the offsets number them.

    Yields
    ------
    index : int
        Of the texture.
    inside : ndarray of bool, shape (K,), or slice
        Which of the texels; a slice of all, if they are of one texture.
    own : ndarray of int, shape (number of these,)
        The same, counted from the first texel of the texture.
    """
    if not len(texels):
        return
    first = int(np.searchsorted(offsets, texels.min(), "right")) - 1
    last = int(np.searchsorted(offsets, texels.max(), "right")) - 1
    for index in range(first, last + 1):
        begin, end = offsets[index : index + 2].tolist()
        if first == last:
            yield index, slice(None), texels - begin
            return
        inside = (texels >= begin) & (texels < end)
        if inside.any():
            yield index, inside, texels[inside] - begin


def refresh_halo(planes: NDArray[np.float32], atlas: Atlas, *, interpolated: bool = False) -> None:
    """Give the halo cells of all planes, in place, the values of the owned cells that they stand for.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Values on the canvas.
    atlas : Atlas
        Which cells are halo, and where their values come from.
    interpolated : bool
        Whether a halo cell gets the mean of the cells around its place, for values that are smooth and to be seen; or
        that of the nearest. For colours to be averaged the nearest is better: a mean has less noise than other samples,
        and beside an edge it is a colour that neither side has, over which kernels find their way across.
    """
    for plane in planes.reshape(len(planes), -1):
        for block in large_arrays.blocks(len(atlas.halo_cells), large_arrays.SCATTERED):
            cells = atlas.halo_cells[block]
            if interpolated:
                plane[cells] = np.einsum("ht,ht->h", plane[atlas.halo_taps[block]], atlas.halo_weights[block])
            else:
                plane[cells] = plane[atlas.halo_nearest[block]]


def without_halo(atlas: Atlas, dropped: NDArray[np.bool_]) -> Atlas:
    """Return the atlas with some of its halo cells empty.

    Parameters
    ----------
    atlas : Atlas
        The atlas.
    dropped : ndarray of bool, shape (H,)
        Halo cells that become EMPTY.

    Returns
    -------
    Atlas
    """
    kind = atlas.kind.copy()
    kind.reshape(-1)[atlas.halo_cells[dropped]] = EMPTY
    seen = kind.reshape(-1)[atlas.gutter_cells] != EMPTY
    return dataclasses.replace(
        atlas,
        kind=kind,
        gutter_cells=atlas.gutter_cells[seen],
        gutter_texels=atlas.gutter_texels[seen],
        halo_cells=atlas.halo_cells[~dropped],
        halo_taps=atlas.halo_taps[~dropped],
        halo_weights=atlas.halo_weights[~dropped],
        halo_seams=atlas.halo_seams[~dropped],
    )


def without_owned(atlas: Atlas, dropped: NDArray[np.bool_]) -> Atlas:
    """Return the atlas with some of its owned cells empty, and halo cells without their colours.

    Parameters
    ----------
    atlas : Atlas
        The atlas.
    dropped : ndarray of bool, shape (T,)
        Owned cells that become EMPTY: texels that lend no colour.

    Returns
    -------
    Atlas
        Halo cells that drew on nothing else are EMPTY too.
    """
    gone = np.zeros(atlas.kind.size, bool)
    gone[atlas.owned_cells[dropped]] = True
    weights = np.where(gone[atlas.halo_taps], 0, atlas.halo_weights)
    total = weights.sum(axis=1)
    orphaned = total <= 0
    weights /= np.where(orphaned, 1, total)[:, None]
    kind = atlas.kind.copy()
    kind.reshape(-1)[gone] = EMPTY
    kept = dataclasses.replace(
        atlas,
        kind=kind,
        owned_cells=atlas.owned_cells[~dropped],
        owned_texels=atlas.owned_texels[~dropped],
        chart_of=atlas.chart_of[~dropped],
        halo_weights=weights.astype(np.float32),
    )
    return without_halo(kept, orphaned)
