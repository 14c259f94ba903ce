"""Charts: a closed mesh is cut into pieces, and each is laid flat."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def neighbours(faces: NDArray[np.int64]) -> list[list[int]]:
    """Return the triangles next to each triangle."""
    adjacent: list[list[int]] = [[] for _ in faces]
    owner: dict[tuple[int, int], int] = {}
    for face, (a, b, c) in enumerate(faces.tolist()):
        for edge in ((a, b), (b, c), (c, a)):
            key = (min(edge), max(edge))
            if key in owner:
                adjacent[face].append(owner[key])
                adjacent[owner[key]].append(face)
            owner[key] = face
    return adjacent


def segmented(
    positions: NDArray[np.float64],
    faces: NDArray[np.int64],
    count: int,
    random: np.random.Generator,
    *,
    ragged: float,
    delay: float,
) -> NDArray[np.int64]:
    """Return the chart of each triangle, shape (F,): all charts grow at once from triangles far apart.

    Parameters
    ----------
    positions, faces : ndarray
        The mesh.
    count : int
        How many charts.
    random : Generator
        Decides where charts start, when, and how fast they grow.
    ragged : float
        How much the time to pass from triangle to triangle varies; 0: round charts.
    delay : float
        Mean time that a chart waits before it grows, in mean distances between charts; 0: charts of one size.
    """
    centres = positions[faces].mean(axis=1)
    seeds = [int(random.integers(len(faces)))]
    distance = np.full(len(faces), np.inf)
    for _ in range(count - 1):
        distance = np.minimum(distance, np.linalg.norm(centres - centres[seeds[-1]], axis=1))
        # Rounded, so that equal distances stay equal on every platform.
        seeds.append(int(np.argmax(np.round(distance, 6))))
    waits = np.round(random.exponential(delay * distance.max(), count), 6)
    slowness = np.round(np.exp(ragged * random.standard_normal(len(faces))), 6)
    adjacent = neighbours(faces)
    chart = np.full(len(faces), -1)
    queue = [
        (wait, seed, number) for number, (wait, seed) in enumerate(zip(waits.tolist(), seeds, strict=True))
    ]
    heapq.heapify(queue)
    while queue:
        time, face, number = heapq.heappop(queue)
        if chart[face] < 0:
            chart[face] = number
            for other in adjacent[face]:
                step = slowness[other] * np.linalg.norm(centres[other] - centres[face])
                heapq.heappush(queue, (float(np.round(time + step, 6)), other, number))
    return np.unique(chart, return_inverse=True)[1]


def flattened(positions: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return a chart's vertices laid flat at their size, shape (V, 2): the least squares conformal map.

    References
    ----------
    B. Levy, S. Petitjean, N. Ray, J. Maillot, "Least Squares Conformal Maps for Automatic Texture Atlas
    Generation", SIGGRAPH 2002, doi:10.1145/566654.566590.
    """
    a, b, c = (positions[faces[:, k]] for k in range(3))
    along = np.linalg.norm(b - a, axis=1)
    x = ((c - a) * (b - a)).sum(axis=1) / along
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / along
    flat = np.stack([np.zeros(len(faces)), along, x + 1j * height], axis=1)
    weights = (np.roll(flat, -2, axis=1) - np.roll(flat, -1, axis=1)) / np.sqrt(along * height)[:, None]
    system = np.zeros((len(faces), len(positions)), complex)
    np.put_along_axis(system, faces, weights, axis=1)
    distance = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    first = int(np.argmax(np.round(distance, 6)))
    distance = np.linalg.norm(positions - positions[first], axis=1)
    last = int(np.argmax(np.round(distance, 6)))
    free = np.setdiff1d(np.arange(len(positions)), [first, last])
    # Complex least squares: two vertices are held, the others follow.
    normal, right = system[:, free].conj().T, -system[:, last] * distance[last]
    plane = np.zeros(len(positions), complex)
    plane[last] = distance[last]
    plane[free] = np.linalg.solve(normal @ system[:, free], normal @ right)
    laid = plane[faces]
    area = np.imag((laid[:, 1] - laid[:, 0]).conj() * (laid[:, 2] - laid[:, 0])).sum()
    plane *= np.sqrt((along * height).sum() / area)
    return np.column_stack([plane.real, plane.imag])
