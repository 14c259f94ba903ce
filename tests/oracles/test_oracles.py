"""The oracles agree with what is known without them."""

import numpy as np
import pytest
from hypothesis import given, settings

from oracles import strategies, surfaces
from oracles.geodesics import Manifold, exact_distances, graph_distances, triangle_update


@pytest.mark.parametrize("front", [0.0, 0.3, 0.7, 1.0])
def test_a_plane_front_crosses_a_triangle_exactly(front):
    # C at the origin, A and B on either side of the direction from which the front comes, along the first axis.
    a, b = np.array([1.3, 0.5]), np.array([1.1, -0.8])
    turn = 0.4 * (front - 0.5)
    a, b = (np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ p for p in (a, b))
    phi_a, phi_b, phi_c = 5 - a[0], 5 - b[0], 5.0
    if phi_a > phi_b:
        a, b, phi_a, phi_b = b, a, phi_b, phi_a
    to_a, to_b = np.linalg.norm(a), np.linalg.norm(b)
    assert triangle_update(phi_a, to_a, phi_b, to_b, a @ b / (to_a * to_b)) == pytest.approx(phi_c, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_marching_agrees_with_exact_distances_on_mild_terrain(seed):
    positions, faces = surfaces.terrain(15, 15, 0.2, seed)
    exact = exact_distances(positions, faces, 112)
    ratio = np.delete(Manifold(positions, faces).distances(112), 112) / np.delete(exact, 112)
    # One update across the diagonal of a square is off by (1 + 1/sqrt 2) / sqrt 2 = 1.207, and none is worse.
    assert ratio.min() > 0.99
    assert ratio.max() < 1.24
    assert np.sqrt(((ratio - 1) ** 2).mean()) < 0.06


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(strategies.meshes())
def test_distances_are_no_longer_than_paths_over_edges_and_reach_as_far(mesh):
    positions, faces = mesh
    found, over_edges = Manifold(positions, faces).distances(0), graph_distances(positions, faces, 0)[0]
    assert found[0] == 0
    assert (found >= 0).all()
    assert (found <= over_edges * (1 + 1e-9) + 1e-12).all()
    assert np.array_equal(np.isfinite(found), np.isfinite(over_edges))


def test_the_support_of_a_split_corner_lies_where_unfolding_puts_it():
    # An obtuse corner at the origin, and two faces beyond the edge that faces it, all in one plane.
    points = np.array([[0, 0], [4.0, 0], [-3.5, 1.5], [-3, 4], [0.6, 5]])
    faces = np.array([[0, 1, 2], [2, 1, 3], [3, 1, 4]])
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((4, 4)))[0]
    turned = np.column_stack([points, 0 * points]) @ turn
    manifold = Manifold(turned, faces)
    assert manifold.edges[4][0] == pytest.approx(np.hypot(0.6, 5))
    assert (0, 4) in manifold.stencils[1]
    assert (0, 4) in manifold.stencils[2]
    # A third face at the edge (1, 3) ends the unfolding there.
    fin = np.concatenate([faces, [[1, 3, 5]]])
    assert 0 not in Manifold(np.vstack([turned, 9 * turned[4]]), fin).edges[4]
