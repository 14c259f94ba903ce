"""A tube about a torus knot: closed, of genus one, coloured in ribbons and spots with smooth gradients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from samples import Sample, normalised, quantised

Array = NDArray[np.float64]
RINGS, SIDES = 216, 24
TWIST = 3
THICKNESS = 0.27


def make() -> Sample:
    """Return the knot with 216 rings of 24 vertices."""
    ring, side = np.divmod(np.arange(RINGS * SIDES), SIDES)
    # The rows of the grid wind about the tube, so that the borders of the ribbons follow edges of the mesh.
    along, around = ring / RINGS, side / SIDES - TWIST * ring / RINGS
    there = (ring + 1) % RINGS * SIDES
    a, b = ring * SIDES + side, ring * SIDES + (side + 1) % SIDES
    c, d = there + side, there + (side + 1) % SIDES
    triangles = np.stack([a, b, d, a, d, c], axis=1).reshape(-1, 3)
    polygons = tuple(map(tuple, triangles.tolist()))
    return Sample(normalised(surface(along, around)), polygons, quantised(pattern(ring, side)))


def surface(along: Array, around: Array) -> Array:
    """Return the tube about the (2, 3) torus knot, shape (V, 3)."""
    s, phi = 2 * np.pi * along, 2 * np.pi * around[:, None]
    tangent = centre(s + 1e-4) - centre(s - 1e-4)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # The outward normal of the torus that the knot winds about gives a frame that closes after one turn.
    outward = centre(s) - np.column_stack([np.cos(2 * s), np.sin(2 * s), np.zeros_like(s)])
    outward -= (outward * tangent).sum(axis=1, keepdims=True) * tangent
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return centre(s) + THICKNESS * (np.cos(phi) * outward + np.sin(phi) * np.cross(tangent, outward))


def centre(s: Array) -> Array:
    """Return the torus knot at the angles `s`, shape (V, 3)."""
    reach = 1.0 + 0.45 * np.cos(3 * s)
    return np.column_stack([reach * np.cos(2 * s), reach * np.sin(2 * s), 0.45 * np.sin(3 * s)])


def pattern(ring: NDArray[np.int64], side: NDArray[np.int64]) -> Array:
    """Return two ribbons that wind about the tube, and a row of spots, shape (V, 3) in [0, 1].

    Inside each region the colour changes slowly; all borders are sharp.
    """
    turn = (ring / RINGS)[:, None]
    rainbow = 0.56 + 0.36 * np.cos(2 * np.pi * (turn + np.array([0.0, 0.33, 0.67])))
    shade = 0.5 + 0.5 * np.cos(2 * np.pi * (side[:, None] / SIDES - 2 * turn))
    cream = np.array([0.99, 0.95, 0.84]) - shade * np.array([0.12, 0.17, 0.20])
    night = np.array([0.12, 0.14, 0.32]) + shade * np.array([0.12, 0.16, 0.18])
    is_cream = side < SIDES // 2
    # A spot sits on every twelfth ring in the middle of the cream ribbon; the twist shears the grid.
    x = (ring + 6) % 12 - 6
    y = side - SIDES // 4 - TWIST * SIDES / RINGS * x
    spot = is_cream & (x**2 + y**2 < 3.7**2)
    return np.where(spot[:, None], night, np.where(is_cream[:, None], cream, rainbow))
