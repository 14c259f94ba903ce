"""Colours of a cloud are smoothed as on the mesh that it was taken from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

import beltrami_cli
from beltrami_cli.errors import UsageError
from oracles import surfaces


def noisy(count, seed=0, channels=3):
    return 0.5 + 0.1 * np.random.default_rng(seed).standard_normal((count, channels))


def strips(positions, width, seed=1):
    """Stripes of two colours across x, with noise."""
    return np.where(np.floor(positions[:, :1] / width) % 2 > 0, [0.8, 0.4, 0.3], [0.2, 0.5, 0.6]) + 0.05 * (
        np.random.default_rng(seed).standard_normal((len(positions), 3))
    )


def scattered(count, side, seed=2):
    """Points at random in a square."""
    flat = np.random.default_rng(seed).uniform(0, side, (count, 2))
    return np.column_stack([flat, np.zeros(count)])


@pytest.mark.slow
def test_the_vertices_of_a_sphere_are_smoothed_as_with_its_faces():
    """Its triangles are found again, so only the order of sums may differ."""
    positions, faces = surfaces.icosphere(4)
    colours = strips(positions, 0.3)
    cloud = beltrami_cli.smooth(positions, None, colours)
    mesh = beltrami_cli.smooth(positions, faces, colours)
    assert cloud.cloud.triangles == len(faces)
    assert cloud.cloud.outliers == 0
    assert mesh.cloud is None
    assert cloud.beta == pytest.approx(mesh.beta, rel=1e-6)
    assert np.abs(cloud.colours - mesh.colours).max() < 1e-5


def test_on_a_plane_the_kernel_agrees_with_that_on_the_delaunay_triangulation():
    """Only at the rim, where slender triangles are left out, may anything differ."""
    positions = scattered(3000, 50)
    faces = Delaunay(positions[:, :2]).simplices
    colours = noisy(3000)
    settings = {"beta": 5, "t": 1.0, "iterations": 1, "metric_scale": 0}
    cloud = beltrami_cli.smooth(positions, None, colours, units="world", **settings).colours
    mesh = beltrami_cli.smooth(positions, faces, colours, units="world", **settings).colours
    difference = np.abs(cloud - mesh).max(axis=1)
    middle = ((positions[:, :2] > 6) & (positions[:, :2] < 44)).all(axis=1)
    change = np.abs(mesh - colours)[middle].mean()
    assert np.quantile(difference[middle], 0.95) < 1e-5
    assert difference[middle].mean() < 0.01 * change


def test_a_plain_kernel_on_points_at_random_tends_to_the_gaussian_of_the_plane():
    """First order in the spacing: with four times as many points the error at least halves but for its noise.

    A linear image is kept by a Gaussian as it is wherever the points around lie evenly; at random they do not, so the
    mean is weighted by area.
    """
    errors = []
    for count, seed in ((500, 3), (2000, 4), (8000, 5)):
        positions = scattered(count, 1, seed)
        wave = np.cos(2 * np.pi * positions[:, :1])
        t = 0.0005
        smoothed = beltrami_cli.smooth(
            positions, None, wave, beta=0, t=t, units="world", weights="area", iterations=1, threshold=1e-6
        ).colours
        truth = np.exp(-t * (2 * np.pi) ** 2) * wave
        middle = ((positions[:, :2] > 0.2) & (positions[:, :2] < 0.8)).all(axis=1)
        errors.append(np.sqrt(np.mean((smoothed - truth)[middle] ** 2)))
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]


@pytest.mark.slow
def test_outliers_are_counted_and_keep_their_colours():
    surface = scattered(2000, 40)
    strewn = np.random.default_rng(14).uniform(-300, 300, (60, 3))
    strewn[:, 2] += np.sign(strewn[:, 2]) * 20
    colours = noisy(2060)
    result = beltrami_cli.smooth(np.concatenate([surface, strewn]), None, colours)
    alone = beltrami_cli.smooth(surface, None, colours[:2000])
    assert result.cloud.outliers == 60
    assert np.array_equal(result.colours[2000:], colours[2000:])
    assert np.abs(result.colours[:2000] - alone.colours).max() < 1e-4
    assert result.noise == pytest.approx(alone.noise)


def test_coincident_points_of_different_colours_are_averaged():
    """As two scans that overlap, whose coordinates are rounded to the same numbers."""
    places = np.stack(np.meshgrid(np.arange(30.0), np.arange(30.0), [0.0]), axis=-1).reshape(-1, 3)
    twice = np.concatenate([places, places])
    clean = 0.5 + 0.3 * np.sin(twice[:, :1] / 8)
    colours = clean + 0.08 * np.random.default_rng(15).standard_normal((1800, 1))
    result = beltrami_cli.smooth(twice, None, colours, beta=10, noise=np.full((1800, 1), 0.08))
    assert result.samples == 1800
    assert result.hard_edge_samples == 900
    error = np.sqrt(np.mean((result.colours - clean) ** 2))
    single = beltrami_cli.smooth(places, None, colours[:900], beta=10, noise=np.full((900, 1), 0.08))
    assert error < np.sqrt(np.mean((single.colours - clean[:900]) ** 2))
    assert np.abs(result.colours[:900] - result.colours[900:]).mean() < 0.02


@pytest.mark.parametrize("count", range(6))
def test_tiny_clouds_are_smoothed_as_far_as_they_can(count):
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 0]])[:count]
    colours = noisy(count)
    result = beltrami_cli.smooth(positions, None, colours, beta=1, iterations=3)
    assert result.cloud.outliers == (count if count < 3 else 0)
    assert np.array_equal(result.colours, colours) == (count < 3)


def test_points_in_a_plane_may_have_two_coordinates():
    positions = scattered(500, 20)
    two = beltrami_cli.smooth(positions[:, :2], None, noisy(500)).colours
    assert np.array_equal(two, beltrami_cli.smooth(positions, None, noisy(500)).colours)


@pytest.mark.parametrize("change", [{"positions": np.eye(4)}, {"smooth_geometry": True}])
def test_what_needs_faces_is_refused_without(change):
    arguments = {"positions": np.eye(4)[:, :3], "faces": None, "colours": noisy(4), **change}
    with pytest.raises(UsageError, match="faces"):
        beltrami_cli.smooth(**arguments)
