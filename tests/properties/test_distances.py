"""Geodesic distances on the image manifold, against truths that are not our code."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from oracles import strategies, surfaces
from oracles.exact_geodesic import exact_distances
from oracles.fast_marching import Manifold
from properties.manifolds import distances, image_manifold


def smooth_image(make, side):
    """A grey image (x, y, I) with I = sin x cos y: the plane, its colours, and the exact distances from the middle."""
    flat, faces = make(side, side, 3 / (side - 1))
    grey = (np.sin(flat[:, 0]) * np.cos(flat[:, 1]))[:, None]
    source = (side // 2) * side + side // 2
    return flat, faces, grey, source, exact_distances(np.column_stack([flat[:, :2], grey]), faces, source)


@pytest.mark.slow
@given(strategies.painted(strategies.meshes(general=True)))
@settings(max_examples=75, deadline=None)
def test_distances_equal_those_of_a_textbook_march_on_any_mesh(painted):
    positions, faces, colours = painted
    manifold = image_manifold(positions, faces, colours, 2.0)
    oracle = Manifold(np.hstack([positions, 2.0 * colours.astype(float)]), faces)
    for source in range(len(positions)):
        ours, truth = distances(manifold, len(positions), source), oracle.distances(source)
        # Lengths are rounded to float32 once (6e-8) and a path adds up a dozen; near-degenerate triangles
        # amplify the rounding of heights, which enter by their squares: its root is 2.4e-4.
        np.testing.assert_allclose(ours, truth, rtol=1e-3, atol=1e-5)


def test_distances_converge_to_exact_ones_at_first_order_under_refinement():
    errors = []
    for side in (17, 33, 65):
        flat, faces, grey, source, truth = smooth_image(surfaces.lattice, side)
        ours = distances(image_manifold(flat, faces, grey, 1.0), len(flat), source)
        errors.append(np.abs(ours - truth).mean())
    # At a point source the error of a first-order scheme is of the order h log(L / h). With L / h = 16, 32, 64 it falls
    # by 2 log 16 / log 32 = 1.60 and by 1.67; a tenth is left for terms of higher order.
    assert errors[0] > 1.5 * errors[1]
    assert errors[1] > 1.55 * errors[2]
    assert errors[2] < 0.015


def test_all_obtuse_corners_of_a_closed_surface_find_a_support():
    positions, faces = surfaces.icosphere(3)
    colours = np.random.default_rng(0).random((len(positions), 3))
    manifold = image_manifold(20 * positions, faces, colours, 20.0)
    assert manifold.obtuse_corners > 0.1 * len(faces)
    assert manifold.split_corners >= 0.99 * manifold.obtuse_corners


def test_the_march_stops_at_the_radius_and_loses_nothing_within():
    positions, faces = surfaces.icosphere(3)
    colours = np.random.default_rng(2).random((len(positions), 2))
    manifold = image_manifold(positions, faces, colours, 0.5)
    everything = distances(manifold, len(positions), 7)
    within = distances(manifold, len(positions), 7, radius=0.6)
    assert np.array_equal(np.isfinite(within), everything <= np.float32(0.6))
    assert np.array_equal(within[np.isfinite(within)], everything[np.isfinite(within)])
