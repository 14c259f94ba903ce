"""The oracles agree with what is known without them."""

from __future__ import annotations

from math import inf, log, pi

import numpy as np
import pytest
from hypothesis import given, settings
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from oracles import strategies, surfaces
from oracles.exact_geodesic import exact_distances
from oracles.fast_marching import Manifold, distances, triangle_update
from oracles.kernel import embed, short_time_kernel
from oracles.laplacian import laplace_beltrami


def edge_distances(embedding, faces, source):
    """Return the lengths of the shortest paths over edges alone."""
    pairs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    if not len(pairs):
        return np.where(np.arange(len(embedding)) == source, 0.0, inf)
    lengths = np.linalg.norm(embedding[pairs[:, 0]] - embedding[pairs[:, 1]], axis=1)
    # A stored zero would mean no edge.
    graph = sparse.coo_array(
        (np.maximum(lengths, 1e-300), (pairs[:, 0], pairs[:, 1])), shape=[len(embedding)] * 2
    )
    return dijkstra(graph.tocsr(), directed=False, indices=source)


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


def test_a_front_from_outside_the_triangle_does_not_cross_it():
    assert triangle_update(0.0, 1.0, 0.99, 1.0, 0.5) == inf


@pytest.mark.slow
@pytest.mark.parametrize("make", [surfaces.plane, surfaces.lattice])
def test_distances_on_a_plane_converge_to_euclid_at_first_order(make):
    # For a source in one point the error of a first-order scheme is of order h log(1/h).
    constants = []
    for cells in (8, 16, 32):
        positions, faces = make(cells + 1, cells + 1, 1 / cells)
        source = (cells + 1) * (cells // 2) + cells // 2
        error = distances(positions, faces, source) - np.linalg.norm(positions - positions[source], axis=1)
        assert error.min() > -1e-12  # interpolation of a convex function lies above it
        constants.append(error.max() * cells / log(cells))
    assert constants[0] < 0.3
    assert constants[0] >= 0.99 * constants[1] >= 0.98 * constants[2]


@pytest.mark.parametrize(("shear", "gain"), [(0.8, 1.0), (1.5, 2.0), (3.0, 2.0)])
def test_split_corners_of_a_sheared_plane_stay_above_euclid_and_come_closer(shear, gain):
    positions, faces = surfaces.plane(11, 11)
    positions[:, :2] += np.random.default_rng(2).uniform(-0.2, 0.2, (len(positions), 2))
    positions[:, 0] -= shear * positions[:, 1]
    straight = np.linalg.norm(positions - positions[60], axis=1)
    split, whole = (distances(positions, faces, 60, unfold=unfold) - straight for unfold in (True, False))
    # Wherever a support is unfolded to, in a plane it must be where it is.
    assert split.min() > -1e-12
    assert split.mean() < whole.mean() / gain


@pytest.mark.slow
def test_distances_on_a_sphere_converge_to_arcs():
    errors = []
    for subdivisions in (2, 3, 4):
        positions, faces = surfaces.icosphere(subdivisions)
        found = distances(positions, faces, 0)
        arcs = np.arccos(np.clip(positions @ positions[0], -1, 1))
        errors.append(np.abs(found - arcs).mean())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.02


def test_distances_do_not_feel_the_bending_of_a_cylinder():
    flat, faces = surfaces.lattice(13, 13)
    rolled = surfaces.rolled_cylinder(flat, radius=40.0)
    # Chords are shorter than arcs by (h / r)^2 / 24.
    assert distances(rolled, faces, 84) == pytest.approx(distances(flat, faces, 84), rel=1e-4)


def test_exact_distances_are_exact_on_a_plane():
    positions, faces = surfaces.plane(7, 9)
    positions[:, :2] += np.random.default_rng(3).uniform(-0.3, 0.3, (len(positions), 2))
    assert exact_distances(positions, faces, 31) == pytest.approx(
        np.linalg.norm(positions - positions[31], axis=1)
    )


@pytest.mark.parametrize("seed", range(3))
def test_marching_agrees_with_exact_distances_on_mild_terrain(seed):
    positions, faces = surfaces.terrain(15, 15, 0.2, seed)
    exact = exact_distances(positions, faces, 112)
    ratio = np.delete(distances(positions, faces, 112), 112) / np.delete(exact, 112)
    # One update across the diagonal of a square is off by (1 + 1/sqrt 2) / sqrt 2 = 1.207, and none is worse.
    assert ratio.min() > 0.99
    assert ratio.max() < 1.24
    assert np.sqrt(((ratio - 1) ** 2).mean()) < 0.06


def test_unfolding_more_than_halves_the_error_on_very_noisy_patches(capsys):
    # Grey noise of 20/255 at beta 13 is a terrain of about this roughness: one corner in seven is obtuse.
    squares = {True: [], False: []}
    for seed in range(4):
        positions, faces = surfaces.terrain(13, 13, 1.0, seed)
        exact = exact_distances(positions, faces, 84)
        near = (exact > 0) & (exact < 6)
        for unfold, gathered in squares.items():
            found = distances(positions, faces, 84, unfold=unfold)
            gathered.append(((found[near] / exact[near] - 1) ** 2).mean())
    split, whole = (np.sqrt(np.mean(squares[unfold])) for unfold in (True, False))
    with capsys.disabled():
        print(f" [rms error {100 * split:.1f} % unfolded, {100 * whole:.1f} % not] ", end="")
    assert split < whole / 2
    assert split < 0.06


def test_stopping_leaves_accepted_distances_as_they_are():
    positions, faces = surfaces.terrain(9, 9, 0.5, 0)
    everywhere, near = distances(positions, faces, 40), distances(positions, faces, 40, stop=2.5)
    assert np.array_equal(near, np.where(everywhere <= 2.5, everywhere, inf))
    assert 5 < np.isfinite(near).sum() < 60


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(strategies.meshes())
def test_distances_are_no_longer_than_paths_over_edges_and_reach_as_far(mesh):
    positions, faces = mesh
    for unfold in (True, False):
        found = distances(positions, faces, 0, unfold=unfold)
        assert found[0] == 0
        assert (found >= 0).all()
        over_edges = edge_distances(positions, faces, 0)
        assert (found <= over_edges * (1 + 1e-9) + 1e-12).all()
        assert np.array_equal(np.isfinite(found), np.isfinite(over_edges))


@settings(max_examples=100, deadline=None)
@given(strategies.meshes())
def test_order_and_repetition_of_faces_do_not_matter(mesh):
    positions, faces = mesh
    shuffled = np.concatenate([faces[::-1, ::-1], faces[:, [1, 2, 0]]])
    assert np.array_equal(distances(positions, faces, 0), distances(positions, shuffled, 0))


def test_the_support_of_a_split_corner_lies_where_unfolding_puts_it():
    # An obtuse corner at the origin, and two faces beyond the edge that faces it, all in one plane.
    points = np.array([[0, 0], [4.0, 0], [-3.5, 1.5], [-3, 4], [0.6, 5]])
    faces = np.array([[0, 1, 2], [2, 1, 3], [3, 1, 4]])
    turned = (
        np.column_stack([points, 0 * points])
        @ np.linalg.qr(np.random.default_rng(1).standard_normal((4, 4)))[0]
    )
    manifold = Manifold(turned, faces)
    assert manifold.edges[4][0] == pytest.approx(np.hypot(0.6, 5))
    assert (0, 4) in manifold.stencils[1]
    assert (0, 4) in manifold.stencils[2]
    # A third face at the edge (1, 3) ends the unfolding there.
    fin = np.concatenate([faces, [[1, 3, 5]]])
    assert 0 not in Manifold(np.vstack([turned, 9 * turned[4]]), fin).edges[4]


def test_one_kernel_on_a_plane_is_the_sampled_gaussian():
    # t and the threshold keep the kernel within one edge of the lattice, where distances are exact.
    positions, faces = surfaces.lattice(5, 5)
    colours = np.eye(25)
    t = 0.2
    smoothed = short_time_kernel(
        embed(positions, colours, 0.0), faces, colours, t, threshold=np.exp(-1.2 / (4 * t))
    )
    centre = smoothed[12]
    ring = np.exp(-1 / (4 * t))
    assert (centre > 0).sum() == 7
    assert centre[12] == pytest.approx(1 / (1 + 6 * ring))
    assert sorted(centre)[-7:-1] == pytest.approx([ring / (1 + 6 * ring)] * 6)


def test_a_kernel_weighs_its_samples_and_leaves_lone_ones():
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]])
    colours = np.array([[0.0], [1.0], [1.0], [0.7]])
    weights = np.array([1.0, 3.0, 0.0, 0.0])
    smoothed = short_time_kernel(positions, np.array([[0, 1, 2]]), colours, 0.5, weights=weights)
    near = np.exp(-0.5)
    assert smoothed[0, 0] == pytest.approx(3 * near / (1 + 3 * near))
    assert smoothed[3, 0] == 0.7


@settings(max_examples=40, deadline=None)
@given(strategies.painted())
def test_a_kernel_stays_within_the_colours_and_keeps_constants(mesh):
    positions, faces, colours = mesh[0], mesh[1], mesh[2].astype(float)
    smoothed = short_time_kernel(embed(positions, colours, 2.0), faces, colours, 0.3)
    assert (smoothed >= colours.min(axis=0) - 1e-12).all()
    assert (smoothed <= colours.max(axis=0) + 1e-12).all()
    constant = np.full_like(colours, 0.3)
    kept = short_time_kernel(embed(positions, constant, 2.0), faces, constant, 0.3)
    assert kept == pytest.approx(constant, abs=1e-12)


def test_the_laplacian_of_linear_functions_vanishes_inside_a_plane():
    positions, faces = surfaces.plane(9, 9)
    inside = ((positions > 0) & (positions < 8))[:, :2].all(axis=1)
    positions[inside, :2] += np.random.default_rng(5).uniform(-0.2, 0.2, (inside.sum(), 2))
    # Turned into six dimensions, the plane is the same plane.
    turned = positions @ np.linalg.qr(np.random.default_rng(6).standard_normal((6, 3)))[0].T
    stiffness, mass = laplace_beltrami(turned, faces)
    assert mass.sum() == pytest.approx(64)
    linear = 3 * positions[:, 0] - 2 * positions[:, 1] + 1
    assert np.abs((stiffness @ linear)[inside]).max() < 1e-11


def test_the_laplacian_has_spherical_harmonics_with_their_eigenvalues():
    positions, faces = surfaces.icosphere(4)
    stiffness, mass = laplace_beltrami(positions, faces)
    x, y, z = positions.T
    assert mass.sum() == pytest.approx(4 * pi, rel=5e-3)
    for degree, harmonic in (
        (0, np.ones(len(x))),
        (1, z),
        (2, x * y),
        (2, 3 * z**2 - 1),
        (3, x * (5 * z**2 - 1)),
    ):
        quotient = harmonic @ stiffness @ harmonic / (harmonic @ (mass * harmonic))
        assert quotient == pytest.approx(-degree * (degree + 1), rel=0.01, abs=1e-9)
        # The pointwise operator is right on average; at the twelve corners of the icosahedron it is off.
        residual = (stiffness @ harmonic) / mass + degree * (degree + 1) * harmonic
        assert np.sqrt((mass * residual**2).sum() / (mass * harmonic**2).sum()) < 0.06 * max(degree, 1) ** 2


def test_the_icosphere_is_closed_and_its_faces_look_outwards():
    positions, faces = surfaces.icosphere(3)
    assert len(positions) == 10 * 4**3 + 2
    _, count = np.unique(
        np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_counts=True
    )
    assert (count == 2).all()
    a, b, c = (positions[faces[:, k]] for k in range(3))
    assert ((np.cross(a, b) * c).sum(axis=1) > 0).all()
    assert surfaces.mean_edge_length(positions, faces) == pytest.approx(0.15, rel=0.05)


@pytest.mark.parametrize("roll", [surfaces.rolled_cylinder, surfaces.rolled_cone])
def test_rolled_planes_keep_short_lengths(roll):
    flat, faces = surfaces.plane(9, 9, 0.25)
    flat[:, 0] += 20
    rolled = roll(flat, 30.0 if roll is surfaces.rolled_cylinder else 0.5)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        here, there = (np.linalg.norm(p[faces[:, a]] - p[faces[:, b]], axis=1) for p in (flat, rolled))
        assert there == pytest.approx(here, rel=1e-4)
