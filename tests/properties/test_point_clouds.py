"""Colours of a cloud are smoothed as on the mesh that it was taken from."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.errors import UsageError
from oracles import surfaces


def noisy(count):
    return 0.5 + 0.1 * np.random.default_rng(0).standard_normal((count, 3))


@pytest.mark.slow
def test_the_vertices_of_a_sphere_are_smoothed_as_with_its_faces():
    """Its triangles are found again, so only the order of sums may differ."""
    positions, faces = surfaces.icosphere(4)
    colours = noisy(len(positions)) + 0.2 * np.sign(np.sin(10 * positions))
    cloud = beltrami_cli.smooth(positions, None, colours)
    mesh = beltrami_cli.smooth(positions, faces, colours)
    assert cloud.cloud.triangles == len(faces)
    assert cloud.cloud.outliers == 0
    assert mesh.cloud is None
    assert cloud.beta == pytest.approx(mesh.beta, rel=1e-6)
    assert np.abs(cloud.colours - mesh.colours).max() < 1e-5


@pytest.mark.slow
def test_outliers_are_counted_and_keep_their_colours():
    surface = np.pad(np.random.default_rng(2).uniform(0, 40, (2000, 2)), ((0, 0), (0, 1)))
    strewn = np.random.default_rng(14).uniform(-300, 300, (60, 3))
    strewn[:, 2] += np.sign(strewn[:, 2]) * 20
    colours = noisy(2060)
    result = beltrami_cli.smooth(np.concatenate([surface, strewn]), None, colours)
    alone = beltrami_cli.smooth(surface, None, colours[:2000])
    assert result.cloud.outliers == 60
    assert np.array_equal(result.colours[2000:], colours[2000:])
    assert np.abs(result.colours[:2000] - alone.colours).max() < 1e-4
    assert result.noise == pytest.approx(alone.noise)


@pytest.mark.parametrize("count", range(6))
def test_tiny_clouds_are_smoothed_as_far_as_they_can(count):
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 0]])[:count]
    colours = noisy(count)
    result = beltrami_cli.smooth(positions, None, colours, beta=1, iterations=3)
    assert result.cloud.outliers == (count if count < 3 else 0)
    assert np.array_equal(result.colours, colours) == (count < 3)


@pytest.mark.parametrize("change", [{"positions": np.eye(4)}, {"smooth_geometry": True}])
def test_what_needs_faces_is_refused_without(change):
    arguments = {"positions": np.eye(4)[:, :3], "faces": None, "colours": noisy(4), **change}
    with pytest.raises(UsageError, match="faces"):
        beltrami_cli.smooth(**arguments)
