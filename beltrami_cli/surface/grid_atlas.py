"""Regular images as samples: every pixel has a place, on the plane of the image or on a surface that it maps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.atlas import EMPTY, OWNED, Atlas

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Row and column of the neighbours whose distances an atlas keeps: right, below, below right, below left.
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


def grid_atlas(
    shape: tuple[int, int],
    margin: int,
    positions: NDArray[np.float64] | None = None,
    valid: NDArray[np.bool_] | None = None,
) -> Atlas:
    """Lay out one regular image as a parametric manifold: a single chart, without seams.

    Parameters
    ----------
    shape : (int, int)
        Rows H and columns W of the image.
    margin : int
        How many empty cells stand around it: the reach of a kernel.
    positions : ndarray of float64, shape (H, W, M), optional
        Places of the pixels in a space of any dimension M; pixels with a value that is not finite are holes.
        Without it pixels lie on the plane (x, y), 1 apart.
    valid : ndarray of bool, shape (H, W), optional
        False where the image has a hole, which nothing crosses. Without it there are none. Holes that touch at
        their corners are a closed wall.

    Returns
    -------
    Atlas
        Pixels are OWNED, holes and margins EMPTY. `owned_texels` are row * W + column.

    Raises
    ------
    ValueError
        If the shapes of the arrays do not fit.
    """
    filled = _filled(shape, positions, valid)
    kind = np.pad(np.where(filled, np.uint8(OWNED), np.uint8(EMPTY)), margin)
    lengths = np.full((len(_STEPS), *kind.shape), np.inf, np.float32)
    image = lengths[:, margin : margin + shape[0], margin : margin + shape[1]]
    for plane, step in zip(image, _STEPS, strict=True):
        _measure(plane, step, filled, positions)
    owned = np.flatnonzero(kind).astype(np.int64, copy=False)
    nothing, no_taps = np.zeros(0, np.int64), (0, 4)
    return Atlas(
        kind=kind,
        squared_lengths=lengths,
        owned_cells=owned,
        owned_texels=np.flatnonzero(filled).astype(np.int64, copy=False),
        texture_offsets=np.array([0, shape[0] * shape[1]], np.int64),
        cut_cells=nothing,
        halo_cells=nothing,
        halo_taps=np.zeros(no_taps, np.int64),
        halo_weights=np.zeros(no_taps, np.float32),
        halo_seams=np.zeros(0, np.int32),
        gutter_cells=nothing,
        gutter_texels=nothing,
        chart_of=np.zeros(len(owned), np.int32),
        charts=1,
        seams=0,
        seam_edges=0,
        covered=len(owned),
        overlapped=0,
    )


def _filled(
    shape: tuple[int, int], positions: NDArray[np.float64] | None, valid: NDArray[np.bool_] | None
) -> NDArray[np.bool_]:
    """Tell which pixels are no holes."""
    if valid is not None and valid.shape != shape:
        raise ValueError(f"valid has the shape {valid.shape}, but the image {shape}")
    if positions is not None and (positions.ndim != 3 or positions.shape[:2] != shape):
        raise ValueError(f"positions have the shape {positions.shape}, but the image {shape}")
    filled = np.ones(shape, bool) if valid is None else valid
    return filled if positions is None else filled & np.isfinite(positions).all(axis=2)


def _measure(
    plane: NDArray[np.float32],
    step: tuple[int, int],
    filled: NDArray[np.bool_],
    positions: NDArray[np.float64] | None,
) -> None:
    """Write the squared lengths of the edges in one direction; those at holes stay infinite."""
    here, there = _ends(step)
    edges = filled[here] & filled[there]
    if 0 not in step:  # a diagonal is an edge of triangles, of which a hole at its side takes one away
        edges &= filled[here[0], there[1]] | filled[there[0], here[1]]
    if positions is None:
        plane[here][edges] = step[0] ** 2 + step[1] ** 2
        return
    total = np.zeros(edges.shape)
    # The background of a map may be as far away as numbers go: infinitely far, so that nothing crosses there.
    with np.errstate(over="ignore"):
        for column in np.moveaxis(positions, 2, 0):
            # Differences are taken before any rounding: maps may lie far from the origin.
            steps = np.subtract(column[there], column[here], out=np.zeros(edges.shape), where=edges)
            total += np.square(steps)
        np.copyto(plane[here], total, where=edges, casting="same_kind")


def _ends(step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the cells at which edges in one direction start, and those at which they end."""
    down, right = step
    rows = slice(None, -down or None), slice(down, None)
    if right >= 0:
        columns = slice(None, -right or None), slice(right, None)
    else:
        columns = slice(-right, None), slice(None, right)
    return (rows[0], columns[0]), (rows[1], columns[1])
