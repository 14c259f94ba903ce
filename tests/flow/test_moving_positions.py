"""Geometry that is smoothed along with the colours: noise falls, features stay, and nothing else happens."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.surface.geometry import normal_tensors, on_boundary, vertex_normals
from oracles import surfaces

SIDE = 16


CUBE, CUBE_FACES = surfaces.cube(SIDE)
SPHERE, SPHERE_FACES = surfaces.icosphere(4)
SPHERE = SPHERE / surfaces.mean_edge_length(SPHERE, SPHERE_FACES)
RADIUS = np.linalg.norm(SPHERE[0])


def shaken(positions, sigma=0.15, seed=1):
    return positions + np.random.default_rng(seed).normal(0, sigma, positions.shape)


def moved(positions, faces, colours=None, **parameters):
    colours = np.full((len(positions), 1), 0.4) if colours is None else colours
    return beltrami_cli.smooth(positions, faces, colours, smooth_geometry=True, **parameters)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def off_cube(positions):
    return surfaces.off_cube(positions, SIDE)


def edge_distance():
    """How far vertices of the cube are from its creases."""
    return np.sort(np.minimum(CUBE, SIDE - CUBE), axis=1)[:, 1]


def test_the_noise_of_a_sphere_falls_and_it_hardly_shrinks():
    noisy = shaken(SPHERE)
    before, after = (np.linalg.norm(x, axis=1) for x in (noisy, moved(noisy, SPHERE_FACES).positions))
    assert rms(after - RADIUS) < 0.5 * rms(before - RADIUS)
    assert abs(after.mean() / RADIUS - 1) < 0.005


def test_creases_stay_where_plain_smoothing_rounds_them_off():
    """At the same noise in flat parts, the creases of a cube err far less than without normals in the metric."""
    noisy, flat, crease = shaken(CUBE), edge_distance() >= 4, edge_distance() == 0
    kept = off_cube(moved(noisy, CUBE_FACES).positions)
    rounded = off_cube(moved(noisy, CUBE_FACES, normal_beta=0, iterations=1).positions)
    assert rms(kept[flat]) < 0.2 * rms(off_cube(noisy)[flat])
    assert rms(kept[flat]) < rms(rounded[flat])  # one iteration of the plain kernel leaves more noise ...
    assert rms(kept[crease]) < 0.35 * rms(rounded[crease])  # ... and has rounded the creases already
    assert rms(kept[crease]) < rms(off_cube(noisy)[crease])


def test_a_shape_of_flat_faces_without_noise_stays():
    # Kernels end at the creases, and inside a plane vertices may only move along its normal.
    result = moved(CUBE, CUBE_FACES)
    assert np.abs(result.positions - CUBE).max() < 1e-5 * SIDE


def test_a_plane_stays_a_plane_whatever_its_noise_within():
    flat, faces = surfaces.plane(20, 20)
    flat[:, :2] = shaken(flat[:, :2], 0.25)
    turn, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    tilted = flat @ turn.T + [100.0, -50.0, 20.0]
    colours = np.random.default_rng(5).random((len(flat), 3))
    result = moved(tilted, faces, colours)
    # Positions are averaged as float32 of about 20 spacings: each iteration rounds by 20 * 6e-8, twice.
    assert np.abs((result.positions - tilted) @ turn[:, 2]).max() < 2 * 5 * 20 * 6e-8 * 10


def test_the_border_of_an_open_surface_stays_to_the_bit():
    flat, faces = surfaces.terrain(16, 16, 0.2, seed=3)
    result = moved(flat, faces)
    border = on_boundary(faces, len(flat))
    assert border.sum() == 4 * 15
    assert np.array_equal(result.positions[border], flat[border])
    assert rms(result.positions[~border, 2]) < 0.5 * rms(flat[~border, 2])


def test_copies_of_a_vertex_move_together_whatever_their_colours():
    """A sphere of two halves that do not share vertices, one dark and one light: a hard colour edge runs around."""
    noisy = shaken(SPHERE)
    upper = noisy[SPHERE_FACES].mean(axis=1)[:, 2] > 0
    positions = np.concatenate([noisy, noisy])
    faces = np.where(upper[:, None], SPHERE_FACES, SPHERE_FACES + len(noisy))
    colours = np.repeat([[0.8], [0.2]], len(noisy), axis=0)
    result = moved(positions, faces, colours)
    first, second = result.positions[: len(noisy)], result.positions[len(noisy) :]
    assert np.array_equal(first, second)
    assert rms(np.linalg.norm(first, axis=1) - RADIUS) < 0.5 * rms(np.linalg.norm(noisy, axis=1) - RADIUS)
    assert np.abs(result.colours - colours).max() < 1e-6


@pytest.mark.parametrize("scale", [1, 1000, 1e-3])
def test_turning_moving_and_scaling_the_mesh_does_the_same_to_the_result(scale):
    noisy = shaken(CUBE)
    colours = np.random.default_rng(6).random((len(noisy), 3))
    turn, _ = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    here = moved(noisy, CUBE_FACES, colours)
    there = moved(scale * (noisy @ turn.T + [3.0, -70.0, 11.0]), CUBE_FACES, colours)
    back = (there.positions / scale - [3.0, -70.0, 11.0]) @ turn
    assert there.normal_beta == pytest.approx(here.normal_beta, rel=1e-4)
    # Rounding moves samples over the cut-off, where they weigh 0.01 of some 10.
    assert rms(back - here.positions) < 1e-3
    assert rms(there.colours - here.colours) < 1e-3


def test_the_colours_are_averaged_by_the_kernel_that_moves_the_vertices():
    noisy = shaken(CUBE)
    result = moved(noisy, CUBE_FACES, np.full((len(noisy), 3), 0.3))
    assert np.array_equal(result.colours, np.full((len(noisy), 3), 0.3))
    # Colours that are each vertex's face of the cube do not mix over its creases.
    face = np.eye(3)[np.abs(CUBE - SIDE / 2).argmax(axis=1)]
    flat = edge_distance() >= 1
    assert np.abs(moved(noisy, CUBE_FACES, face, beta=0).colours - face)[flat].max() < 0.02


def test_normals_and_their_tensors_distinguish_faces_creases_and_corners():
    alone = np.arange(len(CUBE), dtype=np.int32)
    normals = vertex_normals(CUBE, CUBE_FACES, alone)
    tensors = normal_tensors(CUBE, CUBE_FACES, alone)
    on = np.minimum(CUBE, SIDE - CUBE) == 0
    assert np.all(np.sign(normals[on]) == np.sign((CUBE - SIDE / 2)[on]))
    eigenvalues = np.linalg.eigvalsh(tensors)
    assert np.allclose(eigenvalues[:, 2], 1)
    for count in (1, 2, 3):  # as many directions as faces that meet
        large = (eigenvalues[on.sum(axis=1) == count] > 0.2).sum(axis=1)
        assert np.all(large == count)


def test_triangles_that_cancel_or_have_no_area_have_no_normal():
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 1], [0, 1, 3]], np.int32)
    alone = np.arange(4, dtype=np.int32)
    assert not vertex_normals(positions, faces, alone).any()
    assert np.isfinite(normal_tensors(positions, faces, alone)).all()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"positions": np.zeros((4, 2)), "smooth_geometry": True}, "3 dimensions"),
        ({"normal_beta": 3.0}, "--smooth-geometry"),
        ({"smooth_geometry": True, "normal_beta": -1.0}, "normal_beta"),
        ({"smooth_geometry": True, "normal_beta": "2"}, "normal_beta"),
    ],
)
def test_what_has_no_meaning_is_refused(arguments, said):
    usual = {"positions": np.eye(4, 3), "faces": [[0, 1, 2]], "colours": np.zeros((4, 3))}
    with pytest.raises(beltrami_cli.UsageError, match=said):
        beltrami_cli.smooth(**{**usual, **arguments})
