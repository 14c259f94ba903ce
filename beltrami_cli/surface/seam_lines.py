"""Lines of cells across the seams of an atlas, and the colours at the seam itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.atlas import OWNED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Array, Float64s, Int64s
    from beltrami_cli.surface.atlas import Atlas

# A line through the values 1/2, 3/2 and 5/2 texels from a seam, by least squares, has this value at the seam.
_EXTRAPOLATION = np.array([13, 4, -5]) / 12
REACH = len(_EXTRAPOLATION)


def at_seam(values: Sequence[Array]) -> Float64s:
    """Extrapolate the values of three cells on a line, the nearest first, to the seam; of one, take it."""
    if len(values) == 1:
        return values[0].astype(np.float64)
    total = np.zeros(values[0].shape)
    for weight, each in zip(_EXTRAPOLATION, values, strict=True):
        total += weight * each
    return total


def lines_over_seams(atlas: Atlas, reach: int) -> list[list[Int64s]]:
    """Return lines of cells across seams in all four directions: `reach` owned ones from the seam, then halo ones."""
    columns, size = atlas.kind.shape[1], atlas.kind.size
    owned = atlas.kind.reshape(-1) == OWNED
    beyond = np.zeros(size, bool)
    beyond[atlas.halo_cells[atlas.halo_seams >= 0]] = True
    first = np.flatnonzero(beyond)
    found = []
    for step in (1, -1, columns, -columns):
        line = [first - step * (k + 1) for k in range(reach)] + [first + step * k for k in range(reach)]
        fits = np.ones(len(first), bool)
        for number, cells in enumerate(line):
            inside = (cells >= 0) & (cells < size)
            fits &= inside & (owned if number < reach else beyond)[np.where(inside, cells, 0)]
        found.append([cells[fits] for cells in line])
    return found
