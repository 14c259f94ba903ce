"""Small meshes whose geometry is known, as (positions (V, 3) float64, faces (F, 3) int32)."""

from itertools import combinations

import numpy as np

GOLDEN = (1 + 5**0.5) / 2


def grid_faces(rows, columns):
    """Return the triangles of a grid, every cell cut along the same diagonal, shape (F, 3)."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)


def plane(rows, columns, spacing=1.0):
    """Return a plane of right triangles; x along columns, y along rows."""
    y, x = (part.ravel() for part in np.mgrid[:rows, :columns])
    return spacing * np.column_stack([x, y, np.zeros(len(x))]).astype(float), grid_faces(rows, columns)


def lattice(rows, columns, spacing=1.0):
    """Return a plane of equilateral triangles, sheared into a parallelogram."""
    y, x = (part.ravel() for part in np.mgrid[:rows, :columns])
    # The diagonal of `grid_faces` joins (x, y) to (x + 1, y + 1), so rows shift to the left.
    points = np.column_stack([x - y / 2, y * 3**0.5 / 2, np.zeros(len(x))])
    return spacing * points, grid_faces(rows, columns)


def graded(flat, power):
    """Draw a plane together towards the lines through its middle, where edges become ever shorter."""
    away = flat - (flat.min(axis=0) + flat.max(axis=0)) / 2
    return np.sign(away) * np.abs(away / max(1e-300, np.abs(away).max())) ** power


def rolled_cylinder(flat, radius):
    """Return plane points (x, y, 0) rolled about an axis along y: distances on the surface stay."""
    x, y, _ = np.asarray(flat, float).T
    return np.column_stack([radius * np.sin(x / radius), y, radius * (1 - np.cos(x / radius))])


def rolled_cone(flat, sine):
    """Return plane points (x, y, 0) rolled into a cone with its tip at the origin, `sine` that of half its opening."""
    x, y, _ = np.asarray(flat, float).T
    r, angle = np.hypot(x, y), np.arctan2(y, x) / sine
    return np.column_stack([r * sine * np.cos(angle), r * sine * np.sin(angle), r * (1 - sine**2) ** 0.5])


def icosphere(subdivisions, radius=1.0):
    """Return an icosahedron subdivided on the sphere: 10 * 4^n + 2 vertices, faces outwards."""
    base = np.array([(0, s, t * GOLDEN) for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(base, k, axis=1) for k in range(3)])
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < 2.1
    triples = [t for t in combinations(range(12), 3) if near[np.ix_(t, t)].all()]
    faces = np.array([t if np.linalg.det(points[list(t)]) > 0 else t[::-1] for t in triples])
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    for _ in range(subdivisions):
        points, faces = subdivided(points, faces)
    return radius * points, faces.astype(np.int32)


def subdivided(points, faces):
    """Return a sphere with every triangle cut in four; new vertices follow the old ones."""
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    key, side_of = np.unique(sides[:, 0].astype(np.int64) * len(points) + sides[:, 1], return_inverse=True)
    middle = points[key // len(points)] + points[key % len(points)]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = (side_of.reshape(-1, 3) + len(points)).T
    a, b, c = faces.T
    four = [np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([points, middle]), np.stack(four, axis=1).reshape(-1, 3)


def terrain(rows, columns, roughness, seed):
    """Return a random height field over the unit-spaced grid; `roughness` is the standard deviation of heights."""
    positions, faces = plane(rows, columns)
    positions[:, 2] = roughness * np.random.default_rng(seed).standard_normal(len(positions))
    return positions, faces


def cube(cells):
    """Return a cube of cells^2 squares a side, cut by alternating diagonals."""
    number, faces = {}, []
    for axis in range(3):
        for level in (0, cells):
            for i in range(cells):
                for j in range(cells):
                    square = []
                    for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                        place = [0, 0, 0]
                        place[axis], place[(axis + 1) % 3], place[(axis + 2) % 3] = level, a, b
                        square.append(number.setdefault(tuple(place), len(number)))
                    if level == 0:
                        square.reverse()
                    a, b, c, d = square
                    faces += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return np.array(list(number), float), np.array(faces, np.int32)


def off_cube(points, side):
    """Return the signed distance of points from the surface of the cube between 0 and `side`, negative inside."""
    out = np.abs(points - side / 2) - side / 2
    return np.linalg.norm(np.maximum(out, 0), axis=1) + np.minimum(out.max(axis=1), 0)


def mean_edge_length(positions, faces):
    """Return the mean length of the edges, each counted once."""
    pairs = np.unique(np.sort(np.asarray(faces)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return float(np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1).mean())
