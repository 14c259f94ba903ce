"""Packing: the charts of a mesh find their places in an image, turned and shuffled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from baking import covering, grown
from charts import flattened

if TYPE_CHECKING:
    from numpy.typing import NDArray

CELL = 2  # texels; charts are placed on a grid of cells


def unwrapped(
    positions: NDArray[np.float64],
    faces: NDArray[np.int64],
    chart_of: NDArray[np.int64],
    size: int,
    scale: float,
    gap: int,
    random: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return texture coordinates, shape (N, 2), and the triangles as rows of them, shape (F, 3).

    `packed` describes the last four parameters.
    """
    charts = []
    corners = np.empty_like(faces)
    count = 0
    for chart in range(chart_of.max() + 1):
        mine = chart_of == chart
        used, local = np.unique(faces[mine], return_inverse=True)
        local = local.reshape(-1, 3)
        corners[mine] = local + count
        count += len(used)
        charts.append((flattened(positions[used], local), local))
    texels = np.concatenate(packed(charts, size, scale, gap, random))
    return np.round(texels / size, 6), corners


def packed(
    charts: list[tuple[NDArray[np.float64], NDArray[np.int64]]],
    size: int,
    scale: float,
    gap: int,
    random: np.random.Generator,
) -> list[NDArray[np.float64]]:
    """Return the charts' coordinates in texels of a square image, each turned at random, the largest placed first.

    Parameters
    ----------
    charts : list of tuple
        Flat vertices, shape (V, 2), and triangles.
    size : int
        Texels along a side.
    scale : float
        Texels for one unit of the charts' coordinates.
    gap : int
        Texels that stay free between charts, and half as many about them all.
    random : Generator
        Decides how charts are turned, and which of the free places they take.

    Raises
    ------
    ValueError
        If a chart finds no place.
    """
    side = size // CELL
    taken = np.zeros((side, side))
    placed: list[NDArray[np.float64]] = [np.empty(0)] * len(charts)
    turns = random.uniform(0, 2 * np.pi, len(charts))
    sizes = [np.ptp(flat, axis=0).prod() for flat, _ in charts]
    for number in np.argsort(-np.round(sizes, 6), kind="stable").tolist():
        flat, faces = charts[number]
        c, s = np.cos(turns[number]), np.sin(turns[number])
        turned = np.round(flat @ np.array([[c, s], [-s, c]]) * scale, 4)
        turned += gap // 2 + CELL - turned.min(axis=0)
        extent = tuple((np.ceil((turned.max(axis=0) + gap // 2) / CELL).astype(int) * CELL).tolist())
        # v points down: mirrored, the triangles keep the side that they show.
        turned[:, 1] = extent[1] - turned[:, 1]
        mask = grown(covering(turned[faces], extent), gap // 2) >= 0
        cells = mask.reshape(extent[1] // CELL, CELL, extent[0] // CELL, CELL).any(axis=(1, 3))
        row, column = free_place(taken, cells, random)
        taken[row : row + len(cells), column : column + cells.shape[1]] += cells
        placed[number] = turned + CELL * np.array([column, row])
    return placed


def free_place(
    taken: NDArray[np.float64], cells: NDArray[np.bool_], random: np.random.Generator
) -> tuple[int, int]:
    """Return row and column where the cells touch none that is taken: one of the places nearest a corner."""
    rows, columns = (total - part + 1 for total, part in zip(taken.shape, cells.shape, strict=True))
    if rows < 1 or columns < 1:
        raise ValueError("a chart is larger than the image")
    # Cross-correlation by Fourier transform; what wraps around lies outside of the slice.
    spectrum = np.fft.rfft2(taken) * np.fft.rfft2(cells, taken.shape).conj()
    touched = np.fft.irfft2(spectrum, taken.shape)[:rows, :columns]
    free = np.argwhere(touched < 0.5)
    if not len(free):
        raise ValueError("the charts do not fit into the image")
    corner = random.integers(0, 2, 2) * (rows - 1, columns - 1)
    row, column = free[np.argmin(np.abs(free - corner).sum(axis=1))]
    return int(row), int(column)
