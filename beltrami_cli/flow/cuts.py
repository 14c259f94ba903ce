"""How surfaces are cut into chunks: canvases into rectangles, meshes into runs of samples."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from beltrami_cli._native import PATCH_BLOCK_SIZE
from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.flow.chunks import Chunk, Part

# Minimum number of cells of a chunk: around a square of this size, patches repeat less than half of the work.
MIN_CELLS = 1 << 18

# Minimum number of samples of a chunk of a mesh, likewise.
MIN_SAMPLES = 1 << 14

Rectangle: TypeAlias = tuple[Any, ...]
"""The index of some cells in stacks of a canvas: an ellipsis, a slice of rows, and one of columns."""


def grown(cells: Rectangle, before: int, after: int, shape: tuple[int, ...]) -> Rectangle:
    """Extend a rectangle by `before` cells above and on the left, `after` below and on the right, within the canvas."""
    sides = zip(cells[1:], shape, strict=True)
    return ..., *(slice(max(0, side.start - before), min(most, side.stop + after)) for side, most in sides)


def chunks_of_canvas(
    cut: Callable[[Rectangle, Rectangle], Part], owned: Bools, count: int, unit: int, before: int, after: int
) -> list[Chunk[Part]]:
    """Cut a canvas into nearly square rectangles with about equal numbers of owned cells.

    They begin at multiples of `unit`, the period of the order of summation. A part has `before` and `after` more cells
    around. `cut` is called with the index of the part on the canvas, and with that of the rectangle within the part.
    """
    count = min(count, max(1, int(np.count_nonzero(owned)) // MIN_CELLS))
    bands = int(np.clip(round((count * owned.shape[0] / max(1, owned.shape[1])) ** 0.5), 1, count))
    shares = np.linspace(0, count, bands + 1).round().astype(int)
    heights, chunks = _split_evenly(owned.sum(axis=1), shares / count, unit), []
    for rows, parts in zip(heights, np.diff(shares).tolist(), strict=True):
        for columns in _split_evenly(owned[rows].sum(axis=0), np.linspace(0, 1, parts + 1), unit):
            place = ..., rows, columns
            around = grown(place, before, after, owned.shape)
            sides = zip(place[1:], around[1:], strict=True)
            core = ..., *(slice(side.start - first.start, side.stop - first.start) for side, first in sides)
            if owned[place].any():
                chunks.append(Chunk(partial(cut, around, core), around, place))
    return chunks


def _split_evenly(counts: Int64s, shares: Float64s, unit: int) -> list[slice]:
    """Cut entries so that the sum of each slice is its share of the total; slices begin at multiples of `unit`."""
    totals = np.concatenate([[0], np.cumsum(counts)])
    borders = np.searchsorted(totals, shares * totals[-1])
    borders = np.minimum((borders + unit // 2) // unit * unit, len(counts))
    borders[-1] = len(counts)
    return [slice(*each) for each in pairwise(borders.tolist())]


def runs(size: int, count: int) -> list[tuple[int, int]]:
    """Cut samples that are sorted by locality into runs of whole blocks."""
    blocks = -(-size // PATCH_BLOCK_SIZE)
    count = min(count, max(1, size // MIN_SAMPLES), blocks)
    borders = np.linspace(0, blocks, count + 1).round().astype(int) * PATCH_BLOCK_SIZE
    return list(pairwise(np.minimum(borders, size).tolist()))
