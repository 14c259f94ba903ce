"""The order of vertices in memory, and what a kernel costs where neighbours in space are not neighbours on the mesh."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli._native import morton_order, vertex_order
from oracles import surfaces


def scattered(side):
    """A lattice whose vertices lie anywhere, with a third triangle at many edges; in any order."""
    random = np.random.default_rng(0)
    _, faces = surfaces.lattice(side, side)
    corners = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([faces, np.column_stack([corners, corners + 1, corners + side + 1])])
    order = random.permutation(side * side)
    return random.standard_normal((side * side, 3)), order[faces].astype(np.int32)


def share_of_near(order, faces, within):
    """Return how many sides of faces have both ends so close in memory."""
    rank = np.argsort(order)
    return np.mean(np.abs(rank[faces] - rank[np.roll(faces, 1, axis=1)]) <= within)


def test_even_surfaces_are_ordered_along_a_curve_through_space():
    positions, faces = surfaces.terrain(70, 70, 0.3, 1)
    order = np.random.default_rng(0).permutation(len(positions))
    positions, faces = positions[order], np.argsort(order)[faces].astype(np.int32)
    assert np.array_equal(vertex_order(positions, faces), morton_order(positions))


def test_neighbours_lie_close_in_memory_wherever_they_lie_in_space():
    side = 100
    positions, faces = scattered(side)
    order = vertex_order(positions, faces)
    assert np.array_equal(np.sort(order), np.arange(side * side))
    assert share_of_near(morton_order(positions), faces, 2 * side) < 0.1
    # Breadth first, fronts are no longer than the lattice's sides both together, and neighbours at most a front apart.
    assert share_of_near(order, faces, 2 * side) > 0.9


@pytest.mark.parametrize(
    "faces", [np.zeros((0, 3)), [[0, 0, 0]], [[3, 1, 2], [9, 8, 8]]], ids=["none", "a point", "two parts"]
)
def test_vertices_of_no_face_and_of_any_part_are_kept(faces):
    positions = np.random.default_rng(0).standard_normal((10, 3))
    order = vertex_order(positions, np.asarray(faces, np.int32))
    assert np.array_equal(np.sort(order), np.arange(10))


@pytest.mark.parametrize("corner", [-1, 10])
def test_corners_that_are_no_vertices_are_refused(corner):
    with pytest.raises(ValueError, match="not there"):
        vertex_order(np.zeros((10, 3)), np.array([[0, 1, corner]], np.int32))
