"""Level sets whose surface is known, sampled on grids."""

import numpy as np

# Off the grid points and their symmetries, so that no value is on the level by chance.
CENTRE = np.array([0.013, -0.031, 0.022])


def places(shape, spacing, origin):
    """Return where the samples of a grid stand, shape (X, Y, Z, 3)."""
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    return origin + index * spacing


def sphere(spacing, radius=1.0, centre=CENTRE):
    """Return (values, spacing (3,), origin) of a sphere's signed distance on a grid that holds it; it is at 0."""
    spacing = np.broadcast_to(np.asarray(spacing, float), 3)
    shape = np.ceil(2 * (radius + 2 * spacing) / spacing).astype(int) + 1
    origin = centre - (shape - 1) * spacing / 2
    return np.linalg.norm(places(shape, spacing, origin) - centre, axis=-1) - radius, spacing, origin


def pattern(directions):
    """Return smooth colours of unit vectors, shape (..., 3), within [0.2, 0.8]."""
    x, y, z = np.moveaxis(directions, -1, 0)
    channels = (np.sin(3 * x + 1), np.cos(2 * y - z), x * z)
    return (0.5 + 0.3 * np.stack(channels, axis=-1)).astype(np.float32)


def directions(points, centre=CENTRE):
    """Return unit vectors from the centre to points."""
    return (points - centre) / np.linalg.norm(points - centre, axis=-1, keepdims=True)


def euler_characteristic(count, faces):
    """Return V - E + F, and how many faces each edge has."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, uses = np.unique(pairs, axis=0, return_counts=True)
    return count - len(edges) + len(faces), uses
