"""The kernel on level sets: against exact values on the sphere and a mesh of it, and what no kernel may do."""

from __future__ import annotations

from math import cos, exp, log, sin, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree
from scipy.special import eval_legendre

from beltrami_cli import SmoothSettings, smooth
from beltrami_cli.formats.access import EVERYTHING_INSIDE
from beltrami_cli.jobs.file_job import open_input
from formats.volume_files import lattice_fields, nrrd_file, sphere_file, write
from oracles.level_sets import CENTRE, directions, pattern, places, sphere
from oracles.surfaces import icosphere

RANDOM = np.random.default_rng(9)
T = 0.02
# Lengths in radii of the sphere, samples by their area: what converges to the continuous kernel.
WORLD = {
    "iterations": 1,
    "t": T,
    "units": "world",
    "weights": "area",
    "metric_scale": 0,
    "space": "data",
    "solver": "fast-marching",  # which converges on finer and finer meshes
}


def opened(path):
    return open_input(str(path), SmoothSettings(), EVERYTHING_INSIDE)


def smoothed_sphere(folder, spacing, beta, colours):
    """Return directions of the vertices, and their colours before and after; given as functions of directions."""
    painted = opened(sphere_file(folder, spacing)).painted()
    there = directions(painted.positions)
    before = colours(there).astype(np.float32)
    after = smooth(painted.positions, painted.faces, before, beta=beta, **WORLD).colours
    return there, before, after


def eigenvalue(degree):
    """Return what the truncated geodesic Gaussian makes of spherical harmonics (Funk and Hecke)."""
    radius = sqrt(-4 * T * log(0.01))

    def integral(order):
        def integrand(angle):
            return exp(-(angle**2) / (4 * T)) * eval_legendre(order, cos(angle)) * sin(angle)

        return quad(integrand, 0, radius)[0]

    return integral(degree) / integral(0)


HARMONICS = {
    2: lambda u: u[:, :1] * u[:, 1:2],
    3: lambda u: 2 * u.prod(axis=1, keepdims=True),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degree", "stretch"),
    [(3, 1), (2, np.array([1, 0.5, 0.75]))],
    ids=["3, cubes", "2, boxes"],
)
def test_harmonics_on_a_sphere_shrink_by_their_eigenvalue_to_first_order(degree, stretch, tmp_path):
    errors = []
    for spacing in (0.2, 0.05):
        _, before, after = smoothed_sphere(tmp_path, spacing * stretch, 0, HARMONICS[degree])
        errors.append(np.sqrt(np.mean((after - eigenvalue(degree) * before) ** 2)))
    # With a quarter of the spacing, the first order is a quarter of the error; what is uneven in a single sampling can
    # double that.
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.05 * (1 - eigenvalue(degree))


@pytest.mark.slow
def test_a_pattern_on_a_level_set_is_smoothed_as_on_an_icosphere_to_first_order(tmp_path):
    beta = 2.0
    points, faces = icosphere(5)
    truth = smooth(points, faces, pattern(points), beta=beta, **WORLD).colours
    errors = []
    for spacing in (0.2, 0.05):
        there, before, after = smoothed_sphere(tmp_path, spacing, beta, pattern)
        errors.append(np.sqrt(np.mean((after - interpolated(points, faces, truth, there)) ** 2)))
    assert errors[1] < errors[0] / 2
    assert errors[1] < 0.1 * np.sqrt(np.mean((after - before) ** 2))


def interpolated(points, faces, colours, there):
    """Return colours of a fine sphere's triangles at directions."""
    middles = points[faces].mean(axis=1)
    nearest = faces[cKDTree(middles / np.linalg.norm(middles, axis=1, keepdims=True)).query(there)[1]]
    weights = np.linalg.solve(points[nearest].transpose(0, 2, 1), there[..., None])
    return (colours[nearest] * weights).sum(axis=1) / weights.sum(axis=1)


def result_of(painted, **parameters):
    return smooth(painted.positions, painted.faces, painted.colours, **parameters).colours


def test_unknown_voxels_separate_what_is_on_both_sides(tmp_path):
    values, steps, origin = sphere(0.2)
    at = places(values.shape, steps, origin)
    mask = np.abs(at[..., 2] - CENTRE[2]) > 0.15
    south = at[..., 2] < CENTRE[2]
    colours = RANDOM.random((*values.shape, 3))
    results = []
    for _ in range(2):
        path = sphere_file(tmp_path, 0.2, lambda at: colours, mask=mask)  # noqa: B023
        painted = opened(path).painted()
        north = painted.positions[:, 2] > CENTRE[2]
        settings = {"iterations": 3, "t": 30.0, "beta": 1.0, "beta_growth": 1.0, "metric_steps": 0}
        after = smooth(painted.positions, painted.faces, painted.colours, **settings).colours
        results.append(after[north])
        colours = np.where((south | ~mask)[..., None], RANDOM.random(colours.shape), colours)
    np.testing.assert_array_equal(*results)
    assert np.abs(after[north] - painted.colours[north]).max() > 0.1
    assert (painted.positions[:, 2] - CENTRE[2] < 0).any()


def test_vertices_without_a_colour_stay_white_and_do_not_count(tmp_path):
    def partly(at):
        return np.where(at[..., :1] > 0.3, np.nan, 0.2 + 0.1 * RANDOM.random((*at.shape[:3], 3)))

    document = opened(sphere_file(tmp_path, 0.2, partly))
    painted = document.painted()
    bare = (painted.colours == 1).all(axis=1)
    assert f"{bare.sum()} of {len(bare)} vertices have no colour" in document.notices[0]
    assert painted.positions[bare, 0].min() > 0.1
    after = result_of(painted)
    assert (after[bare] == 1).all()
    assert after[~bare].max() <= 0.3
    assert len(document.contents().offsets) - 1 > len(painted.faces)  # the surface itself has no hole


@pytest.mark.slow
def test_turned_mirrored_and_scaled_grids_give_the_same_colours(tmp_path):
    values, steps, _ = sphere(0.3)
    colours = RANDOM.random((3, *values.shape)).astype(np.float32)
    both = np.concatenate([values[None].astype(np.float32), colours])
    angle = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
    documents = []
    for axes in (np.eye(3), 1000 * angle, np.diag([1.0, 1.0, -1.0])):
        fields = lattice_fields(axes * steps[0], [5.0, 6.0, 7.0], 0)
        documents.append(opened(write(tmp_path / "v.nrrd", nrrd_file(both, **fields))).painted())
    first, *others = (result_of(painted, patches="off") for painted in documents)
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-4)
