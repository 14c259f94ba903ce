"""Sheets that no manifold can hold: three meet along one edge, and a ribbon passes through itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from samples import Sample, normalised, quantised

Array = NDArray[np.float64]
HEIGHT = 18  # rows of vertices of a sheet
WIDTH = 20  # columns of a sheet beyond the edge that all three share
HARD = 10  # column of the first sheet whose vertices are doubled, red on one side and white on the other
ROUND = 46  # columns of the ribbon; the last closes it over vertices of the same places and colours
ACROSS = 7  # rows of the ribbon


def make() -> Sample:
    """Return the sheets and the ribbon, with a duplicate face, a face without area and a lone vertex."""
    spine = [(0.0, h / (HEIGHT - 1), 0.0) for h in range(HEIGHT)]
    positions, colours = [np.array(spine)], [np.full((HEIGHT, 3), 0.92)]
    faces: list[NDArray[np.int64]] = []
    count = HEIGHT
    for number in range(3):
        points, shades, triangles = sheet(number)
        # Row h of a sheet starts at the spine, whose vertices come first; its own follow those before it.
        faces.append(np.where(triangles < HEIGHT, triangles, triangles + count - HEIGHT))
        positions.append(points)
        colours.append(shades)
        count += len(points)
    points, shades, triangles = ribbon()
    faces.append(triangles + count)
    lone = np.array([[0.55, 1.12, 0.0]])
    # The duplicate lies inside the second sheet; the face without area on three places in line on its border.
    second = HEIGHT + (WIDTH + 1) * HEIGHT
    border = second + (WIDTH - 1) * HEIGHT
    faces += [faces[1][[90]], np.array([[border, border + 1, border + 2]])]
    everything = normalised(np.concatenate([*positions, points, lone]))
    everywhere = np.concatenate([*colours, shades, [[0.2, 0.7, 0.3]]])
    return Sample(everything, tuple(map(tuple, np.concatenate(faces).tolist())), quantised(everywhere))


def grid_triangles(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return two triangles for every cell of a grid of vertex indices, shape (F, 3)."""
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    even = np.add.outer(np.arange(index.shape[0] - 1), np.arange(index.shape[1] - 1)).ravel() % 2 == 0
    first = np.where(even[:, None], np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    other = np.where(even[:, None], np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    return np.concatenate([first, other])


def sheet(number: int) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return a sheet's vertices beyond the spine, colours, and triangles (the spine is 0 .. HEIGHT - 1)."""
    columns = np.arange(1, WIDTH + 1)
    if number == 0:
        columns = np.insert(columns, HARD, HARD)
    column, row = (part.ravel() for part in np.meshgrid(columns, np.arange(HEIGHT), indexing="ij"))
    reach, up = column / WIDTH, row / (HEIGHT - 1)
    angle = np.radians((200, 335, 95))[number] + 0.35 * reach
    wave = up + 0.05 * reach * np.sin(5 * up)
    points = np.column_stack([reach * np.cos(angle), wave, -reach * np.sin(angle)])
    index = np.arange(len(columns) * HEIGHT).reshape(-1, HEIGHT) + HEIGHT
    parts = [np.vstack([np.arange(HEIGHT), index])]
    if number == 0:
        # The two columns at one place are not joined by faces: that makes the border of colours a hard edge.
        parts = [parts[0][: HARD + 1], parts[0][HARD + 1 :]]
    doubled = np.arange(len(column)) >= HARD * HEIGHT
    return (
        points,
        sheet_colours(number, reach, up, doubled),
        np.concatenate([grid_triangles(p) for p in parts]),
    )


def sheet_colours(number: int, reach: Array, up: Array, beyond: NDArray[np.bool_]) -> Array:
    """Return the colours of a sheet, shape (V, 3): a flag, a sun, or a chequer, each shaded slowly."""
    shade = (0.12 * up + 0.06 * reach)[:, None]
    if number == 0:
        return np.where(beyond[:, None], (0.80, 0.78, 0.74), (0.70, 0.14, 0.18)) + shade
    if number == 1:
        sun = (reach - 0.52) ** 2 + (up - 0.52) ** 2 < 0.29**2
        return np.where(sun[:, None], (0.94, 0.70, 0.16), (0.16, 0.36, 0.66)) + shade
    chequer = (np.floor(reach * 3.99) + np.floor(up * 3.99)) % 2 == 0
    return np.where(chequer[:, None], (0.16, 0.48, 0.42), (0.84, 0.80, 0.62)) + shade


def ribbon() -> tuple[Array, Array, NDArray[np.int64]]:
    """Return a figure of eight drawn upwards: it crosses itself, and closes over a seam."""
    step, row = (part.ravel() for part in np.meshgrid(np.arange(ROUND + 1), np.arange(ACROSS), indexing="ij"))
    # A quarter of a step off, so that the two strands cross between vertices and are not welded there.
    angle = 2 * np.pi * (step % ROUND + 0.25) / ROUND
    points = np.column_stack([0.62 * np.sin(angle), 1.28 + 0.05 * row, 0.34 * np.sin(2 * angle)])
    stripe = (step % ROUND) // 6 % 2 == 0
    shade = 0.10 * np.cos(angle)[:, None]
    shades = np.where(stripe[:, None], (0.58, 0.26, 0.60), (0.88, 0.82, 0.88)) + shade
    return points, np.round(shades, 9), grid_triangles(np.arange(len(step)).reshape(-1, ACROSS))
