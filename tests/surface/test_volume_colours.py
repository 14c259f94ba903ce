"""Colours at vertices: exact where they must be, within the range of what lends, and from nothing that does not."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.surface.reconstruction import (
    GridColours,
    Lattice,
    NearColours,
    interpolate_colours,
    nearest_colours,
    places,
)

RANDOM = np.random.default_rng(6)
SHAPE = (4, 5, 6)
# Skewed, turned and of three spacings.
LATTICE = Lattice(np.array([[0.5, 0.1, 0.0], [0.0, 2.0, 0.3], [-0.2, 0.0, 1.0]]), np.array([3.0, -7.0, 11.0]))


def inside(count):
    return RANDOM.random((count, 3)) * (np.array(SHAPE) - 1)


def grid(samples):
    return GridColours(LATTICE, samples)


def test_what_is_linear_along_each_axis_is_interpolated_exactly():
    x, y, z = np.indices(SHAPE).astype(float)
    samples = np.stack([1 + x - 2 * y + 3 * z + x * y * z, x * y - z], axis=-1)[..., [0, 1, 0]]
    at = inside(200)
    x, y, z = at.T
    expected = np.column_stack([1 + x - 2 * y + 3 * z + x * y * z, x * y - z])[:, [0, 1, 0]]
    found = interpolate_colours(grid(samples), places(LATTICE, at))
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("by", ["value", "opacity", "mask"])
def test_voxels_without_a_colour_lend_none_whatever_they_hold(by):
    samples = RANDOM.random((*SHAPE, 4)) * 0.9 + 0.1
    absent = RANDOM.random(SHAPE) < 0.4
    known = None
    if by == "mask":
        known = ~absent
    elif by == "opacity":
        samples[absent, 3] = 0
    samples[absent, :3] = np.nan if by == "value" else 50
    at = inside(300)
    found = interpolate_colours(grid(samples), places(LATTICE, at), known)
    bare = np.isnan(found).any(axis=1)
    corners = np.floor(at).astype(int)[:, None] + np.indices((2, 2, 2)).reshape(3, 8).T
    np.testing.assert_array_equal(bare, absent[tuple(np.moveaxis(corners, -1, 0))].all(axis=1))
    assert found[~bare].max() <= 1 + 1e-12
    constant = np.where(absent[..., None], samples, [0.3, 0.4, 0.5, 1.0])
    found = interpolate_colours(grid(constant), places(LATTICE, at), known)[~bare]
    np.testing.assert_allclose(found, np.broadcast_to([0.3, 0.4, 0.5, 1.0], found.shape), rtol=1e-12)


def test_beyond_the_last_voxel_there_is_no_colour():
    samples = np.full((*SHAPE, 3), 0.25)
    last = np.array(SHAPE) - 1.0
    at = np.array([last, last, last, [-1.1, 0, 0], [-0.5, -0.5, 0]])
    at[1:3, 0] += [0.5, 1.1]
    found = interpolate_colours(grid(samples), places(LATTICE, at))
    np.testing.assert_array_equal(np.isnan(found).any(axis=1), [False, False, True, True, False])
    np.testing.assert_allclose(found[[0, 1, 4]], 0.25)


def test_points_give_their_own_colour_where_they_are_and_a_mean_between():
    points = RANDOM.random((400, 3))
    colours = RANDOM.random((400, 3))
    near = NearColours(points, colours)
    np.testing.assert_allclose(nearest_colours(near, points, 0.1, 1), colours, atol=1e-6)
    found = nearest_colours(near, RANDOM.random((500, 3)), 0.1, 1)
    assert found.min() >= colours.min()
    assert found.max() <= colours.max()
    constant = NearColours(points, np.full((400, 1), 7.0))
    np.testing.assert_allclose(nearest_colours(constant, RANDOM.random((500, 3)), 0.1, 2), 7.0)


def test_points_without_a_colour_and_points_far_away_lend_none():
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [0.1, 0.1, 0]])
    colours = np.array([[9.0, np.nan, 9], [1, 1, 1], [1, 1, 1], [1, 1, 1], [1, 1, 1]])
    found = nearest_colours(NearColours(points, colours), np.array([[0.0, 0, 0], [2.0, 0, 0]]), 0.1, 1)
    np.testing.assert_allclose(found[0], 1)
    assert np.isnan(found[1]).all()
    nothing = NearColours(points[:1], colours[:1])
    assert np.isnan(nearest_colours(nothing, points, 0.1, 1)).all()


def test_sparse_points_reach_as_far_as_they_are_apart():
    points = np.array([[x, y, 0.0] for x in range(6) for y in range(6)])
    found = nearest_colours(NearColours(points, np.ones((36, 3))), np.array([[2.5, 2.5, 0.2]]), 0.01, 1)
    np.testing.assert_allclose(found, 1)
