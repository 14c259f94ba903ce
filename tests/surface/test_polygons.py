"""Triangles cover their polygon exactly once, look the way it does, and stay in its order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.surface.geometry import unit_vectors
from beltrami_cli.surface.polygons import triangulate


def cut(points, *polygons):
    corners = np.array([corner for polygon in polygons for corner in polygon], np.int32)
    offsets = np.concatenate([[0], np.cumsum([len(polygon) for polygon in polygons])]).astype(np.int64)
    return triangulate(points, corners, offsets)


def areas(points, faces):
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a) / 2


def flat(*xy):
    return np.column_stack([np.array(xy, float), np.zeros(len(xy))])


@st.composite
def star_polygons(draw):
    """Simple polygons around the origin, convex or not, counter-clockwise in the plane."""
    size = draw(st.integers(3, 12))
    radii = np.array(draw(st.lists(st.floats(0.2, 2.0), min_size=size, max_size=size)))
    angles = 2 * np.pi * (np.arange(size) + draw(st.floats(0, 1))) / size
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(size)])


@given(star_polygons(), st.integers(0, 2**32 - 1))
def test_triangles_cover_a_simple_polygon_once_and_none_is_inverted(points, seed):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    faces = cut(points @ turn + 7.0, list(range(len(points))))
    signed = areas(points, faces)[:, 2]
    x, y = points[:, 0], points[:, 1]
    whole = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    assert faces.shape == (len(points) - 2, 3)
    assert signed.sum() == pytest.approx(whole, rel=1e-9)
    assert (signed > -1e-9).all()


@given(star_polygons())
def test_every_edge_of_the_polygon_is_an_edge_of_one_triangle(points):
    size = len(points)
    faces = cut(points, list(range(size)))
    directed = {(int(f[i]), int(f[(i + 1) % 3])) for f in faces for i in range(3)}
    assert len(directed) == 3 * len(faces)
    assert {(i, (i + 1) % size) for i in range(size)} <= directed


def test_triangles_stay_as_they_are_and_polygons_keep_their_order():
    points = np.random.default_rng(1).normal(size=(9, 3))
    polygons = [[5, 4, 3], [0, 1], [0, 1, 2, 3], [], [8, 7, 6], [2], [0, 2, 4, 6, 8]]
    faces = cut(points, *polygons)
    assert faces.dtype == np.int32
    assert faces[0].tolist() == [5, 4, 3]
    assert set(faces[1:3].ravel()) == {0, 1, 2, 3}
    assert faces[3].tolist() == [8, 7, 6]
    assert set(faces[4:].ravel()) == {0, 2, 4, 6, 8}


def test_a_convex_quad_is_cut_along_its_shorter_diagonal():
    rhomb = flat((0, -1), (3, 0), (0, 1), (-3, 0))
    for polygon in ([0, 1, 2, 3], [1, 2, 3, 0], [3, 2, 1, 0]):
        assert all({0, 2} <= set(face) for face in cut(rhomb, polygon).tolist())


def test_a_concave_quad_is_cut_along_the_diagonal_inside_it_even_if_longer():
    # An arrow head: corner 2 is reflex, and the other diagonal, outside, is shorter.
    arrow = flat((0, 0), (1, 4), (0, 3), (-1, 4))
    for polygon in ([0, 1, 2, 3], [1, 2, 3, 0], [3, 2, 1, 0]):
        assert all({0, 2} <= set(face) for face in cut(arrow, polygon).tolist())


def test_a_quad_with_a_straight_corner_gets_no_empty_triangle():
    points = flat((0, 0), (1, 0), (2, 0), (1, 1))
    assert (np.linalg.norm(areas(points, cut(points, [0, 1, 2, 3])), axis=1) > 0.4).all()


@settings(max_examples=50)
@given(st.lists(st.integers(0, 3), min_size=0, max_size=9))
def test_degenerate_and_self_crossing_polygons_still_give_n_minus_2(polygon):
    points = flat((0, 0), (1, 1), (1, 0), (0, 1))
    assert cut(points, polygon).shape == (max(len(polygon) - 2, 0), 3)


@pytest.mark.parametrize("size", [4, 5])
def test_huge_polygons_are_cut_without_warnings(size):
    points = np.random.default_rng(3).normal(size=(size, 3)) * 1e300
    assert cut(points, list(range(size))).shape == (size - 2, 3)


@pytest.mark.slow
def test_large_polygons_that_cross_themselves_are_cut_in_bounded_time():
    # Every corner is looked at for every other one at most: with the cube instead, this would take hours.
    points = np.random.default_rng(3).random((3000, 3))
    faces = triangulate(points, np.arange(3000, dtype=np.int32), np.array([0, 3000]))
    assert faces.shape == (2998, 3)
    assert set(faces.ravel().tolist()) == set(range(3000))


def test_polygons_too_large_to_be_cut_are_refused_unless_they_are_convex():
    angle = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(20_000)])
    corners, offsets = np.arange(20_000, dtype=np.int32), np.array([0, 20_000])
    assert len(triangulate(circle, corners, offsets)) == 19_998
    circle[5000] *= 0.5
    with pytest.raises(InputError, match="20000 corners is not convex"):
        triangulate(circle, corners, offsets)


def test_vectors_whose_squares_are_beyond_all_numbers_have_a_direction():
    vectors = np.array([[3e200, 4e200, 0], [0, 0, 0], [3, 4, 0]])
    assert unit_vectors(vectors) == pytest.approx(np.array([[0.6, 0.8, 0], [0, 0, 0], [0.6, 0.8, 0]]))
