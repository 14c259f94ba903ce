"""Steps over the edges of a mesh between vertices from different photographs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.levelling.steps import UNKNOWN, Steps, with_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.surface.atlas import Indices

_LEAST_SPREAD = 1e-3  # of the directions to neighbours, beside the largest, for which a slope is known


def steps_over_edges(
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    colours: NDArray[np.float64],
    photographs: NDArray[np.int64],
) -> tuple[Steps, Indices, NDArray[np.float64]]:
    """Measure the steps over edges of a mesh between photographs; also return each vertex' chart and place in it.

    A chart is what edges join of one photograph.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(pairs, axis=0).astype(np.int64)
    inside = edges[photographs[edges[:, 0]] == photographs[edges[:, 1]]]
    joined = coo_array((np.ones(len(inside)), (inside[:, 0], inside[:, 1])), shape=(len(positions),) * 2)
    count, charts = connected_components(joined, directed=False)
    places = _places(positions, charts, count)
    across = edges[charts[edges[:, 0]] != charts[edges[:, 1]]]
    backwards = charts[across[:, 0]] > charts[across[:, 1]]
    across[backwards] = across[backwards][:, ::-1]
    ends = charts[across].astype(np.int64)
    order = np.lexsort(ends.T[::-1])
    across, ends = across[order], ends[order]
    seams = np.unique(ends, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    slopes = _slopes(positions, colours, inside)
    half = (positions[across[:, 1]] - positions[across[:, 0]]) / 2
    sides = [
        colours[across[:, side]] + sign * np.einsum("kx,kxn->kn", half, slopes[across[:, side]])
        for side, sign in ((0, 1.0), (1, -1.0))
    ]
    steps = Steps(count, ends, np.stack(sides, axis=1), places[across], seams, np.ones(len(ends)), *UNKNOWN)
    return with_noise(steps), charts, places


def _places(positions: NDArray[np.float64], charts: Indices, count: int) -> NDArray[np.float64]:
    """Return the places of vertices in their charts, on the plane of the two directions in which all is longest."""
    centred = positions - positions.mean(axis=0)
    flat = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -2:]
    sizes = np.maximum(np.bincount(charts, minlength=count), 1)[:, None]
    centre = np.column_stack([np.bincount(charts, axis, count) for axis in flat.T]) / sizes
    squares = np.square(flat - centre[charts])
    deviation = np.sqrt(np.column_stack([np.bincount(charts, axis, count) for axis in squares.T]) / sizes)
    return np.asarray((flat - centre[charts]) / np.where(deviation > 0, 2 * deviation, 1)[charts])


def _slopes(
    positions: NDArray[np.float64], colours: NDArray[np.float64], edges: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the slope of colours at each vertex, shape (S, 3, N), by least squares over its edges."""
    directions = positions[edges[:, 1]] - positions[edges[:, 0]]
    rises = colours[edges[:, 1]] - colours[edges[:, 0]]
    spreads = np.zeros((len(positions), 3, 3))
    products = np.zeros((len(positions), 3, colours.shape[1]))
    for side in (0, 1):  # both signs of an edge give the same products
        np.add.at(spreads, edges[:, side], directions[:, :, None] * directions[:, None, :])
        np.add.at(products, edges[:, side], directions[:, :, None] * rises[:, None, :])
    size = np.trace(spreads, axis1=1, axis2=2)
    spreads += np.where(size > 0, _LEAST_SPREAD * size, 1.0)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(spreads, products))
