"""Vertices of very many triangles, and triangles that are no surface: bounded work, and the same results elsewhere."""

import time

import numpy as np
import pytest

from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.arrays.mesh import smooth
from flow.noisy_surfaces import manifold_of
from oracles import surfaces
from oracles.geodesics import Manifold
from properties.manifolds import image_manifold, segment_manifold

SECONDS = 30  # of processor time; a bounded tangle takes a quarter of it, one that is not twice as long


def fan(count):
    """Triangles around one vertex."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    first = np.arange(count)
    faces = np.stack([0 * first, first + 1, (first + 1) % count + 1], axis=1)
    return np.vstack([np.zeros((1, 3)), rim]), faces.astype(np.int32)


def book(count):
    """Triangles on one edge."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    apexes = np.stack([np.cos(angles), np.sin(angles), np.full(count, 0.5)], axis=1)
    faces = np.stack([0 * angles, 0 * angles + 1, np.arange(count) + 2], axis=1)
    return np.vstack([[[0, 0, 0], [0, 0, 1]], apexes]), faces.astype(np.int32)


def tangle(count, size):
    """Triangles with corners at random."""
    random = np.random.default_rng(1)
    return random.random((size, 3)), random.integers(0, size, (count, 3)).astype(np.int32)


def noisy(count):
    return (0.5 + 0.08 * np.random.default_rng(2).standard_normal((count, 3))).astype(np.float32)


# Up to 3 s: unbounded work shows on large tangles only.
@pytest.mark.slow
@pytest.mark.uninstrumented
@pytest.mark.parametrize("mesh", [fan(4_000), book(8_000), tangle(20_000, 10_000), tangle(60_000, 1_000)])
def test_what_is_no_surface_takes_seconds_by_default(mesh):
    positions, faces = mesh
    start = time.process_time()
    result = smooth(positions, faces, noisy(len(positions)))
    assert time.process_time() - start < SECONDS
    assert np.isfinite(result.colours).all()


@pytest.mark.parametrize("mesh", [fan(700), book(700)], ids=["fan", "book"])
def test_fast_marching_past_a_hub_finds_the_distances_of_a_textbook_march(mesh):
    positions, faces = mesh
    colours = noisy(len(positions))
    core = image_manifold(positions, faces, colours, 6.0)
    oracle = Manifold(np.hstack([positions, 6.0 * colours.astype(float)]), faces)
    for source in (0, 1, 5, 350):
        truth = oracle.distances(source)
        for most in (20, 200, len(positions)):
            held, distances = core.distances(source, 100.0, most)
            assert (np.diff(distances) >= 0).all()
            np.testing.assert_allclose(distances, np.sort(truth)[: len(held)], rtol=1e-3, atol=1e-5)
            np.testing.assert_allclose(distances, truth[held], rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("mesh", [fan(4_000), book(3_000), tangle(9_000, 4_000)])
def test_threads_change_nothing_where_kernels_are_cut_short(mesh):
    positions, faces = mesh
    colours = noisy(len(positions))
    core = segment_manifold(positions, faces, colours, 4.0)
    one = core.smooth(colours, None, 2.4, 6.6, 100, 1, None)
    several = core.smooth(colours, None, 2.4, 6.6, 100, 3, None)
    assert np.array_equal(one[0], several[0])
    assert one[1:] == several[1:]


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [(surfaces.plane(60, 60), True), (fan(400), True), (fan(2_000), False), (book(2_000), False),
     (tangle(9_000, 3_000), False)],
)  # fmt: skip
def test_parameters_are_tried_only_where_density_is_uniform(mesh, expected):
    manifold = manifold_of(*mesh, noisy(len(mesh[0])), KernelParameters())
    assert manifold.geometry.work(1.0).has_uniform_density is expected
