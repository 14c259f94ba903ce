"""Points are joined like the surface that they were taken from, without knowing it."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from beltrami_cli.surface.points import faces_of_points, triangulate_points
from beltrami_cli.surface.records import ColouredVertices
from beltrami_cli.surface.sampling import sample_vertices
from oracles import surfaces


def as_set(faces):
    return {tuple(sorted(face)) for face in np.asarray(faces).tolist()}


def grid(rows, columns, jitter=0.0, seed=0):
    y, x = np.mgrid[:rows, :columns].astype(float)
    moves = np.random.default_rng(seed).uniform(-jitter, jitter, (rows * columns, 2))
    return np.column_stack([x.ravel(), y.ravel()]) + moves


def lifted(flat, height=0.0):
    return np.column_stack([flat, np.full(len(flat), height)])


def inside(flat, margin):
    return ((flat > flat.min(axis=0) + margin) & (flat < flat.max(axis=0) - margin)).all(axis=1)


def components(count, faces):
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    return connected_components(coo_array((np.ones(len(edges)), edges.T), (count, count)), directed=False)


def outliers(count, faces):
    return np.setdiff1d(np.arange(count), faces)


def test_in_a_plane_the_triangles_are_those_of_the_delaunay_triangulation():
    flat = grid(50, 50, 0.4)
    middle = np.flatnonzero(inside(flat, 3))
    expected = Delaunay(flat).simplices
    found = triangulate_points(lifted(flat))
    ours, theirs = (as_set(faces[np.isin(faces, middle).all(axis=1)]) for faces in (found, expected))
    assert ours == theirs


def test_vertices_of_a_sphere_get_the_faces_of_the_sphere_back():
    positions, faces = surfaces.icosphere(4)
    assert as_set(triangulate_points(positions)) == as_set(faces)


def test_a_grid_has_both_diagonals_of_every_square():
    found = triangulate_points(lifted(grid(20, 20)))
    assert len(found) == 4 * 19 * 19
    assert np.array_equal(np.unique(np.ptp(found, axis=1)), [20, 21])  # each within one square


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1e-3, 4.2e6), (1e-300, 0), (1e300, 0), (0.03, -7)])
def test_triangles_follow_rotations_scales_and_shifts(scale, shift):
    """Also where millimetres are given in coordinates of thousands of kilometres, of doubles some 1e-9 apart."""
    rng = np.random.default_rng(3)
    positions, _ = surfaces.terrain(30, 30, 0.15, 4)
    positions[:, :2] += rng.uniform(-0.3, 0.3, (900, 2))
    turned = Rotation.random(None, rng).apply(positions) * scale + shift
    assert as_set(triangulate_points(turned)) == as_set(triangulate_points(positions))


def test_order_and_threads_make_no_difference():
    rng = np.random.default_rng(5)
    positions = np.concatenate([lifted(grid(40, 40)), rng.normal((60, 0, 0), 1, (400, 3))])
    found = triangulate_points(positions, 1)
    assert np.array_equal(triangulate_points(positions, 3), found)
    order = rng.permutation(len(positions))
    assert as_set(order[triangulate_points(positions[order], 2)]) == as_set(found)


@pytest.mark.parametrize("gap", [1.5, 2, 3, 5])
def test_sheets_close_to_each_other_are_not_joined(gap):
    flat = grid(40, 40, 0.35)
    positions = np.concatenate([lifted(flat), lifted(grid(40, 40, 0.35, 6) + 0.4, gap)])
    found = triangulate_points(positions)
    assert not len(outliers(len(positions), found))
    # At the rim two sheets nearby look like the edge of a plate.
    middle = np.flatnonzero(np.tile(inside(flat, 3), 2))
    found = found[np.isin(found, middle).any(axis=1)]
    assert ((found < len(flat)).all(axis=1) | (found >= len(flat)).all(axis=1)).all()


def box():
    sides = [grid(20, 20, 0.3, axis) for axis in range(3)]
    return np.concatenate([np.insert(sides[k], k, end, axis=1) for k in range(3) for end in (0, 19)])


def two_densities():
    return lifted(np.concatenate([grid(40, 20, 0.3), 3 * grid(14, 10, 0.3) + [22, 0]]))


def noisy_sphere():
    """A sphere with noise in depth of half a spacing."""
    positions, faces = surfaces.icosphere(4)
    depth = 0.5 * surfaces.mean_edge_length(positions, faces)
    return positions * (1 + depth * np.random.default_rng(7).standard_normal((len(positions), 1)))


def parted(gap):
    flat = grid(30, 30, 0.3)
    flat[flat[:, 0] > 14.5, 0] += gap - 1
    return lifted(flat)


@pytest.mark.parametrize(
    ("positions", "pieces"),
    [(box(), 1), (two_densities(), 1), (noisy_sphere(), 1), (parted(2.5), 1), (parted(7), 2)],
    ids=["box", "two densities", "noise", "narrow gap", "wide gap"],
)
def test_only_wide_gaps_part_a_surface(positions, pieces):
    found = triangulate_points(positions)
    assert not len(outliers(len(positions), found))
    assert components(len(positions), found)[0] == pieces


@pytest.mark.parametrize("sizes", [(9, 12), (12, 12), (20, 15), (9, 9, 9, 9), (12, 500)], ids=str)
@pytest.mark.parametrize("gap", [30, 1000])
def test_small_clouds_far_apart_are_not_joined(sizes, gap):
    """Not even if the neighbours that spacing is measured by are in another one; in 20 samples of each."""
    cloud_of = np.repeat(np.arange(len(sizes)), sizes)
    for seed in range(20):
        random = np.random.default_rng(seed)
        parts = [random.uniform(0, 1, (size, 3)) * [size**0.5, size**0.5, 0.05] for size in sizes]
        positions = np.concatenate(parts) + np.multiply.outer(cloud_of, [gap, 0, 0])
        found = triangulate_points(positions)
        assert len(found)
        assert (np.ptp(cloud_of[found], axis=1) == 0).all()


def test_points_strewn_around_a_surface_are_outliers():
    rng = np.random.default_rng(8)
    surface = lifted(grid(40, 40, 0.3))
    strewn = rng.uniform(-200, 200, (400, 3))
    strewn = strewn[np.abs(strewn[:, 2]) > 10]
    found = triangulate_points(np.concatenate([surface, strewn, surface[[820]] + [0, 0, 8]]))
    count = len(surface) + len(strewn) + 1
    assert outliers(count, found).tolist() == list(range(len(surface), count))


def test_points_in_one_line_have_no_triangles():
    line = np.column_stack([np.linspace(0, 1, 60), np.zeros((60, 2))])
    assert len(triangulate_points(line)) == 0
    wire = line + 1e-4 * np.random.default_rng(9).standard_normal(line.shape)
    assert len(triangulate_points(wire)) == 0


@pytest.mark.parametrize(
    "kind", ["in space", "in a plane", "on few places", "in a line", "nearly coincident"]
)
@pytest.mark.parametrize("count", [5, 23, 60])
def test_clouds_of_any_kind_have_each_triangle_once_for_any_number_of_threads(kind, count):
    random = np.random.default_rng(7)
    places = {
        "in space": random.random((count, 3)),
        "in a plane": random.random((count, 3)) * [1, 1, 0],
        "on few places": np.unique(random.integers(0, 4, (count, 3)).astype(float), axis=0),
        "in a line": random.random((count, 3)) * [1, 0, 0],
        "nearly coincident": 1e6 + random.random((count, 3)) * random.choice([1e-9, 1], (count, 3)),
    }[kind]
    faces = triangulate_points(np.unique(places, axis=0))
    assert np.array_equal(faces, triangulate_points(np.unique(places, axis=0), threads=3))
    assert (np.diff(faces, axis=1) > 0).all()
    assert len(as_set(faces)) == len(faces)
    assert kind != "in a line" or not len(faces)


def test_tiny_clouds_have_what_triangles_they_can():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert [len(triangulate_points(corners[:count])) for count in range(5)] == [0, 0, 0, 1, 4]
    assert len(triangulate_points(corners[:4, :2])) == 4


def test_large_clouds_are_handled_in_blocks():
    positions, faces = surfaces.icosphere(3)
    assert as_set(triangulate_points(positions, at_once=100)) == as_set(faces)


def vertices(positions, colours, space_of=None):
    none, colours = np.empty((0, 3), np.int32), np.asarray(colours, np.float32)
    return ColouredVertices(positions, none, colours, ("grey",), "srgb", "float32", space_of)


def test_coincident_points_take_part_each_with_its_colour():
    rng = np.random.default_rng(10)
    places = lifted(grid(12, 12, 0.3))
    positions = np.concatenate([places, places[:70], places[:70], places[30:40]])
    colours = np.concatenate([np.zeros(144), np.zeros(70), rng.random(80)])[:, None]
    record = vertices(positions, colours)
    faces = faces_of_points(record, 1)
    assert not len(outliers(len(positions), faces))
    record = dataclasses.replace(record, faces=faces)
    sampling = sample_vertices(record)
    surface = sampling.surface(record, record.colours[sampling.first_vertex])
    assert len(surface.colours) == 144 + 80  # copies of the same colour are one sample
    assert components(len(surface.colours), surface.all_faces)[0] == 1
    assert as_set(sampling.place_of[surface.faces]) == as_set(triangulate_points(places))


def test_points_of_different_spaces_are_not_joined():
    places = lifted(grid(8, 8, 0.3))
    spaces = np.repeat(np.array([4, 2], np.int32), 64)
    record = vertices(np.concatenate([places, places + 0.01]), np.zeros((128, 1)), spaces)
    count, label = components(128, faces_of_points(record, 1))
    assert count == 2
    assert len(np.unique(label[:64])) == 1
