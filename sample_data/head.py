"""A bumpy closed head with a cartoon face: sharp features on slowly shaded skin."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from samples import Sample, normalised, quantised

Array = NDArray[np.float64]
FREQUENCY = 26
CLOSER = 1.6
GOLDEN = (1 + 5**0.5) / 2
EYE = (0.158, 0.075)
MOUTH = (0.0, -0.215)


def make() -> Sample:
    """Return the head with 10 FREQUENCY^2 + 2 vertices, which lie closer together on the face."""
    sphere, polygons = geodesic_sphere()
    positions = normalised(surface(gathered(sphere)))
    return Sample(positions, polygons, quantised(pattern(positions)))


def geodesic_sphere(frequency: int = FREQUENCY) -> tuple[Array, tuple[tuple[int, ...], ...]]:
    """Return an icosahedron with every edge cut in parts and blown up to the unit sphere."""
    base = np.array([(0, s, t * GOLDEN) for s, t in itertools.product((-1, 1), repeat=2)], float)
    corners = np.concatenate([np.roll(base, k, axis=1) for k in range(3)])
    near = np.linalg.norm(corners[:, None] - corners[None], axis=2) < 2.1
    i, j = (index.ravel() for index in np.mgrid[: frequency + 1, : frequency + 1])
    i, j = i[i + j <= frequency], j[i + j <= frequency]
    row = {pair: k for k, pair in enumerate(zip(i.tolist(), j.tolist(), strict=True))}
    grid = [(row[a, b], row[a + 1, b], row[a, b + 1]) for a, b in row if a + b < frequency]
    grid += [(row[a + 1, b], row[a + 1, b + 1], row[a, b + 1]) for a, b in row if a + b < frequency - 1]
    weights = np.column_stack([frequency - i - j, i, j]) / frequency
    points, faces = [], []
    for abc in itertools.combinations(range(12), 3):
        if near[np.ix_(abc, abc)].all():
            outside = np.linalg.det(corners[list(abc)]) > 0
            faces.append(np.array(grid)[:, :: 1 if outside else -1] + len(points) * len(row))
            points.append(weights @ corners[list(abc)])
    # Neighbouring faces share the points on their edges.
    sphere, vertex_of = np.unique(np.round(np.concatenate(points), 9) + 0.0, axis=0, return_inverse=True)
    triangles = vertex_of.reshape(-1)[np.concatenate(faces)]
    return sphere / np.linalg.norm(sphere, axis=1, keepdims=True), tuple(map(tuple, triangles.tolist()))


def gathered(sphere: Array) -> Array:
    """Return the points of a unit sphere moved towards +Z by a conformal map: triangles stay well shaped."""
    z = sphere[:, 2:]
    ahead, behind = CLOSER**2 * (1 + z), 1 - z
    return np.hstack([2 * CLOSER * sphere[:, :2], ahead - behind]) / (ahead + behind)


def bump(x: Array, y: Array, at: tuple[float, float], width: float, height: float) -> Array:
    """Return a Gaussian hill of the given standard deviations."""
    return np.exp(-(((x - at[0]) / width) ** 2 + ((y - at[1]) / height) ** 2) / 2)


def surface(sphere: Array) -> Array:
    """Return the head over the unit sphere, shape (V, 3): an egg with nose, brows, cheeks, lips and ears."""
    x, y, z = sphere.T
    full = np.sqrt((1 - np.abs(y) ** 2.7 + 1e-6) / (1 - y**2 + 1e-6))
    jaw = full * (1 - 0.26 * np.clip(-y - 0.1, 0, 1) ** 1.5)
    head = np.column_stack([0.375 * jaw * x, 0.50 * y, 0.42 * jaw * z])
    head *= (1 + 0.06 / (1 + np.exp(-hair_line(x, y, z) / 0.04)))[:, None]
    u, v, side = head[:, 0], head[:, 1], np.abs(head[:, 0])
    face = 0.105 * bump(u, v, (0, -0.045), 0.034, 0.040) + 0.045 * bump(u, v, (0, 0.03), 0.026, 0.07)
    face += 0.030 * bump(side, v, (0.042, -0.065), 0.02, 0.02)
    face += 0.030 * bump(side, v, EYE, 0.06, 0.05) - 0.050 * bump(side, v, EYE, 0.085, 0.065)
    face += 0.022 * bump(side, v, (0.15, 0.18), 0.08, 0.03) + 0.025 * bump(side, v, (0.18, -0.10), 0.07, 0.06)
    for height, at in ((0.030, MOUTH[1] + 0.025), (0.026, MOUTH[1] - 0.033), (0.035, -0.40)):
        face += height * bump(u, v, (0, at), 0.07, 0.020 if at > -0.4 else 0.05)
    head[:, 2] += np.clip(z * 3, 0, 1) * face
    flap = np.clip(1 - ((y + 0.02) / 0.26) ** 2 - ((z + 0.02) / 0.22) ** 2, 0, 1) ** 0.5
    head[:, 0] += np.sign(x) * 0.085 * flap
    return head


def hair_line(x: Array, y: Array, z: Array) -> Array:
    """Return a number that is positive where hair grows, over the unit sphere: a fringe, and the back."""
    fringe = y - 0.60 + 0.06 * np.cos(13 * x + 1) + 0.12 * x
    back = np.minimum(-0.25 - z + 0.9 * np.clip(y, 0, 1), y + 0.55)
    return np.maximum(fringe, back)


def pattern(positions: Array) -> Array:
    """Return the face, shape (V, 3) in [0, 1]. All borders are sharp, all else is shaded slowly."""
    x, y, z = positions.T
    side, front = np.abs(x), z > 0.1
    light = (0.5 + 0.7 * y + 0.35 * z - 0.3 * x)[:, None]
    colours = np.array([0.78, 0.54, 0.42]) + light * np.array([0.22, 0.24, 0.24])
    blush = 0.8 * bump(side, y, (0.21, -0.11), 0.07, 0.055) * front
    shadow = 0.7 * bump(x, y, (0.0, -0.125), 0.06, 0.018) + 0.5 * bump(x, y, (0.045, -0.03), 0.018, 0.06)
    colours += blush[:, None] * np.array([0.06, -0.20, -0.16])
    colours -= (shadow * front)[:, None] * np.array([0.30, 0.28, 0.24])
    colours -= bump(y, z, (0.0, -0.02), 0.06, 0.05)[:, None] * np.array([0.04, 0.14, 0.12])

    def fill(where: NDArray[np.bool_], rgb: tuple[float, float, float], slope: float = 0.0) -> None:
        colours[where] = np.array(rgb) + (slope * (y[where] - 0.3 * x[where]))[:, None]

    def oval(at: tuple[float, float], width: float, height: float) -> NDArray[np.bool_]:
        return front & (((side - at[0]) / width) ** 2 + ((y - at[1]) / height) ** 2 < 1)

    fill(hair_line(2.45 * x, 2 * y, 2.2 * z) > 0, (0.36, 0.22, 0.14), 0.30)
    brow = 0.205 - 1.8 * (side - 0.15) ** 2
    fill(front & (np.abs(y - brow) < 0.021) & (np.abs(side - 0.155) < 0.095), (0.28, 0.15, 0.08))
    fill(oval(EYE, 0.096, 0.076), (0.95, 0.95, 0.93), 0.4)
    iris = (EYE[0] - 0.012, EYE[1] - 0.004)
    fill(oval(iris, 0.054, 0.058), (0.16, 0.42, 0.62), 1.4)
    fill(oval(iris, 0.026, 0.028), (0.05, 0.05, 0.08))
    curve = y - MOUTH[1] - 1.3 * x**2
    fill(front & (np.abs(curve) < 0.062 * np.clip(1 - (x / 0.15) ** 2, 0, 1)), (0.82, 0.22, 0.27), 0.5)
    fill(front & (np.abs(curve) < 0.013) & (side < 0.128), (0.42, 0.07, 0.12))
    return colours
