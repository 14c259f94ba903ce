"""The atlas of a regular image: one chart without seams, on its plane or on positions in space."""

from __future__ import annotations

from functools import partial

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import NO_GUTTER, NO_HALO, OWNED, Atlas, owned_of

# Row and column offsets of the neighbours in `Atlas`: right, below, below right, below left.
STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


def grid_atlas(shape: tuple[int, int], margin: int, positions: Float64s | None, valid: Bools) -> Atlas:
    """Lay out an image, shape (H, W), as one chart without seams, with a border of at least `margin` empty cells."""
    margin += margin % 2  # as charts are: squares of 2 x 2 cells begin at even pixels
    # Invalid pixels and non-finite positions, shape (H, W, M), are holes. Without positions, pixels lie on a plane at a
    # spacing of 1. Nothing crosses a hole, and holes that touch at corners form a closed barrier.
    filled = valid if positions is None else valid & np.isfinite(positions).all(axis=2)
    kind = large_arrays.zeros((shape[0] + 2 * margin, shape[1] + 2 * margin), np.uint8)
    inside = slice(margin, margin + shape[0]), slice(margin, margin + shape[1])
    for rows in large_arrays.blocks(shape[0], large_arrays.ROWS):
        kind[inside][rows][filled[rows]] = OWNED
    measure = partial(_measure_grid, filled, margin, positions)
    texels = large_arrays.indices_of(filled, True)
    return Atlas(
        kind=kind,
        lengths=large_arrays.Droppable(measure(), measure),
        owned=owned_of(kind),
        owned_texels=texels,
        texture_offsets=np.array([0, shape[0] * shape[1]], np.int64),
        cut_cells=np.zeros(0, np.int64), halo=NO_HALO, gutter=NO_GUTTER,
        chart_of=large_arrays.zeros(len(texels), np.int8),
        charts=1, seams=0, covered=len(texels), overlapped=0,
    )  # fmt: skip


def _measure_grid(filled: Bools, margin: int, positions: Float64s | None) -> Float32s:
    height, width = filled.shape
    lengths: Float32s = large_arrays.empty((len(STEPS), height + 2 * margin, width + 2 * margin), np.float32)
    for rows in large_arrays.blocks(lengths.shape[1], large_arrays.ROWS):
        lengths[:, rows] = np.inf
    inside = lengths[:, margin : margin + height, margin : margin + width]
    for rows in large_arrays.blocks(height, large_arrays.ROWS):
        below = slice(rows.start, rows.stop + 1)  # with the row in which edges of the last row end
        places = None if positions is None else positions[below]
        for plane, step in zip(inside[:, below], STEPS, strict=True):
            _measure(plane, step, filled[below], places)
    return lengths


def _measure(plane: Float32s, step: tuple[int, int], filled: Bools, positions: Float64s | None) -> None:
    """Write the squared lengths of the edges in one direction; those at holes remain infinite."""
    here, there = ends_of(step)
    edges = filled[here] & filled[there]
    if 0 not in step:  # a hole beside a diagonal removes one of its two triangles
        edges &= filled[here[0], there[1]] | filled[there[0], here[1]]
    if positions is None:
        plane[here][edges] = step[0] ** 2 + step[1] ** 2
        return
    total = np.zeros(edges.shape)
    # The background of a map may be at the limit of float: an infinite length, which nothing crosses.
    with np.errstate(over="ignore"):
        for column in np.moveaxis(positions, 2, 0):
            # Subtract before rounding, since maps may be far from the origin.
            steps = np.subtract(column[there], column[here], out=np.zeros(edges.shape), where=edges)
            total += np.square(steps)
        np.copyto(plane[here], total, where=edges, casting="same_kind")


def ends_of(step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of the cells at which edges of a direction start and end."""
    down, right = step
    rows = slice(None, -down or None), slice(down, None)
    if right >= 0:
        columns = slice(None, -right or None), slice(right, None)
    else:
        columns = slice(-right, None), slice(None, right)
    return (rows[0], columns[0]), (rows[1], columns[1])
