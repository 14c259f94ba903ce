"""The kernel on level sets: against exact values on the sphere and a mesh of it, and what no kernel may do."""

from __future__ import annotations

from math import cos, exp, log, sin, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre

from beltrami_cli import SmoothSettings, smooth
from beltrami_cli.formats.access import EVERYTHING_INSIDE
from beltrami_cli.jobs.recolour import open_input
from formats.volume_files import sphere_file
from oracles.level_sets import directions

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


HARMONICS = {2: lambda u: u[:, :1] * u[:, 1:2], 3: lambda u: 2 * u.prod(axis=1, keepdims=True)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degree", "stretch"), [(3, 1), (2, np.array([1, 0.5, 0.75]))], ids=["3, cubes", "2, boxes"]
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


def result_of(painted, **parameters):
    return smooth(painted.positions, painted.faces, painted.colours, **parameters).colours


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
