"""Level sets become even, closed triangles, with holes where nothing is known; colours come from voxels or points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.surface import level_sets
from beltrami_cli.surface.level_sets import (
    GridColours,
    Lattice,
    NearColours,
    find_crossings,
    interpolate_colours,
    nearest_colours,
    triangulate_level_set,
)
from oracles.level_sets import CENTRE, euler_characteristic, sphere

RANDOM = np.random.default_rng(5)


def triangulated(values, level=0.0, known=None):
    return triangulate_level_set(values, level, find_crossings(values, level, known), known)


@pytest.mark.parametrize("spacing", [0.3, 0.1, 0.05])
def test_vertices_are_on_the_sphere_to_second_order(spacing):
    values, steps, origin = sphere(spacing)
    vertices, _ = triangulated(values)
    distance = np.linalg.norm(origin + vertices * steps - CENTRE, axis=1) - 1
    # Along an edge the distance bends by at most 1/R: linear interpolation is off by h^2 / 8R. The middle of vertices
    # in a cube of side h is further inside by its half diagonal squared over 2R, 3 h^2 / 8R. A third order remains.
    assert np.abs(distance).max() < 0.5 * spacing**2 * (1 + spacing)


@settings(deadline=None, max_examples=20)
@given(st.tuples(*[st.floats(-0.5, 0.5)] * 3), st.sampled_from([0.3, 0.17]))
def test_a_sphere_anywhere_on_the_grid_is_closed_even_and_faces_outwards(offset, spacing):
    values, steps, origin = sphere(spacing)
    values = np.linalg.norm(
        np.moveaxis(np.indices(values.shape), 0, -1) * steps + origin - np.array(offset) * spacing, axis=-1
    )
    vertices, faces = triangulated(values, level=1.0)
    characteristic, uses = euler_characteristic(len(vertices), faces)
    assert characteristic == 2
    assert (uses == 2).all()
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = np.array(offset) - origin / spacing
    assert ((corners.mean(axis=1) - middle) * normals).sum(axis=1).min() > 0
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    # Without the compaction there are edges of a thousandth of a voxel. Two clusters touch at most at their corners.
    assert lengths.min() > 1 / 3
    assert lengths.max() < 3


def test_the_two_sides_of_a_sheet_thinner_than_a_voxel_stay_apart():
    x, y, z = np.indices((14, 14, 10)) - np.array([6.5, 6.5, 4.5])[:, None, None, None]
    values = np.maximum(np.maximum(abs(x) - 4.3, abs(y) - 4.2), abs(z - 0.5) - 0.45)
    vertices, faces = triangulated(values)
    characteristic, uses = euler_characteristic(len(vertices), faces)
    assert characteristic == 2
    assert (uses == 2).all()
    inner = np.abs(vertices[:, :2] - 6.5).max(axis=1) < 3
    heights = np.sort(vertices[inner, 2]) - 5
    np.testing.assert_allclose(np.abs(heights), 0.45, atol=1e-5)


def test_values_on_the_level_itself_leave_no_holes():
    values = RANDOM.integers(-3, 4, (16, 16, 16)).astype(np.int8)
    values = np.pad(values, 1, constant_values=5)
    _, faces = triangulated(values)
    _, uses = euler_characteristic(0, faces)
    assert (uses % 2 == 0).all()  # closed: every edge lies between two faces, or twice two
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)


def test_unknown_voxels_are_holes_and_their_values_have_no_influence():
    values, _, _ = sphere(0.2)
    whole, _ = triangulated(values)
    unknown = tuple(np.array([8, 8, 12]))
    holed = values.copy()
    holed[unknown] = np.nan
    vertices, faces = triangulated(holed)
    middle = vertices[faces].mean(axis=1)
    assert not (np.abs(middle - unknown) < 1).all(axis=1).any()  # no triangle in the eight cells around it
    _, uses = euler_characteristic(0, faces)
    assert (uses == 1).any()
    assert len(vertices) < len(whole)
    known = np.ones(values.shape, bool)
    known[unknown] = False
    for value in (-50.0, 0.0, 50.0, np.inf):
        holed[unknown] = value
        again = triangulated(holed, known=known)
        np.testing.assert_array_equal(again[0], vertices)
        np.testing.assert_array_equal(again[1], faces)


def test_a_surface_that_no_known_cell_holds_is_empty():
    values = np.array([-1.0, 1.0, np.nan]).repeat(4).reshape(3, 2, 2)
    values[1, 0, 0] = np.nan
    vertices, faces = triangulated(values)
    assert vertices.shape == faces.shape == (0, 3)


@pytest.mark.parametrize("slab", [1, 100, 1 << 22])
def test_crossings_are_counted_alike_in_slabs_and_at_once(slab, monkeypatch):
    monkeypatch.setattr(level_sets, "SLAB", slab)
    values = RANDOM.standard_normal((9, 7, 8))
    values[RANDOM.random(values.shape) < 0.1] = np.nan
    count = 0
    for axis in range(3):
        a, b = np.moveaxis(values, axis, 0)[:-1] - 0.3, np.moveaxis(values, axis, 0)[1:] - 0.3
        count += int((a * b < 0).sum())
    assert find_crossings(values, 0.3).count == count
    without_slabs, _ = triangulated(values, 0.3)
    monkeypatch.setattr(level_sets, "SLAB", 1 << 22)
    np.testing.assert_array_equal(triangulated(values, 0.3)[0], without_slabs)


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
    found = interpolate_colours(grid(samples), LATTICE.in_space(at))
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
    found = interpolate_colours(grid(samples), LATTICE.in_space(at), known)
    bare = np.isnan(found).any(axis=1)
    corners = np.floor(at).astype(int)[:, None] + np.indices((2, 2, 2)).reshape(3, 8).T
    np.testing.assert_array_equal(bare, absent[tuple(np.moveaxis(corners, -1, 0))].all(axis=1))
    assert found[~bare].max() <= 1 + 1e-12
    constant = np.where(absent[..., None], samples, [0.3, 0.4, 0.5, 1.0])
    found = interpolate_colours(grid(constant), LATTICE.in_space(at), known)[~bare]
    np.testing.assert_allclose(found, np.broadcast_to([0.3, 0.4, 0.5, 1.0], found.shape), rtol=1e-12)


def test_beyond_the_last_voxel_there_is_no_colour():
    samples = np.full((*SHAPE, 3), 0.25)
    last = np.array(SHAPE) - 1.0
    at = np.array([last, last, last, [-1.1, 0, 0], [-0.5, -0.5, 0]])
    at[1:3, 0] += [0.5, 1.1]
    found = interpolate_colours(grid(samples), LATTICE.in_space(at))
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
