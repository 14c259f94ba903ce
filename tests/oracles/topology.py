"""Edges and components of meshes, counted in the plainest way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Edges(NamedTuple):
    """Each edge once: its ends, shape (E, 2), and how many triangles hold it."""

    ends: np.ndarray
    count: np.ndarray


def edges(triangles):
    """Return the edges of triangles."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return Edges(*np.unique(np.sort(pairs, axis=1), axis=0, return_counts=True))


def components(count, pairs):
    """Return how many groups `count` things form that are joined in pairs, shape (P, 2)."""
    parent = list(range(count))

    def root(thing):
        while parent[thing] != thing:
            parent[thing] = parent[parent[thing]]
            thing = parent[thing]
        return thing

    for a, b in pairs.tolist():
        parent[root(a)] = root(b)
    return len({root(thing) for thing in range(count)})
