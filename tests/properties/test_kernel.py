"""One iteration of the kernel, and the flow, against the truths of the method."""

import functools
from math import log

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import beltrami_cli
from oracles import strategies, surfaces
from oracles.geodesics import embed, short_time_kernel
from properties.manifolds import apply_kernel, image_manifold, one_iteration, require_same, segment_manifold

# A colour may flip in or out at the cut-off, where its weight is the threshold and float32 decides otherwise
# than double: with few samples that moves the mean by about the threshold times the colour range.
CUT_OFF = 1e-4


@given(
    strategies.coloured_meshes(strategies.meshes(general=True)),
    st.sampled_from((0.05, 0.5, 5.0)),
    st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_a_kernel_equals_the_textbook_on_any_mesh_and_any_number_of_channels(mesh, t, weighted):
    positions, faces, colours = mesh
    weights = np.random.default_rng(0).random(len(positions)) if weighted else None
    ours = one_iteration(positions, faces, colours, 2.0, t, CUT_OFF, weights)
    truth = short_time_kernel(embed(positions, colours, 2.0), faces, colours, t, CUT_OFF, weights)
    np.testing.assert_allclose(ours, truth, atol=5e-3)


@pytest.mark.parametrize(
    ("manifold", "t", "tolerance"),
    [
        # Distances of fast marching are too long by a few per cent away from the lattice's lines (first order at a
        # point source), so weights are too small by at most d^2/4t exp(-d^2/4t) times twice that, their sum likewise.
        (image_manifold, 4.0, 0.08),
        # Here, where no strip of three triangles is crossed straight, a path of segments bends by 15 degrees at most:
        # it is too long by at most 1 / cos 15 degrees - 1 = 3.5 %, and the sum of weights too small by twice that
        # times the mean of d^2/4t, 0.95.
        (segment_manifold, 2.0, 0.066),
    ],
    ids=["fast marching", "segments"],
)
def test_without_beta_a_plane_is_smoothed_by_the_gaussian(manifold, t, tolerance):
    flat, faces = surfaces.lattice(41, 41)
    impulse = np.zeros((len(flat), 1))
    centre = 20 * 41 + 20
    impulse[centre] = 1
    ours, _, _ = apply_kernel(manifold(flat, faces, impulse, 0.0), impulse, t)
    away = np.sum((flat - flat[centre]) ** 2, axis=1)
    truth = np.where(away <= -4 * t * log(0.01), np.exp(-away / (4 * t)), 0)
    np.testing.assert_allclose(ours[:, 0], truth / truth.sum(), atol=tolerance * truth.max() / truth.sum())
    variance = (ours[:, 0] * away).sum() / ours.sum() / 2
    truncated = 2 * t * (1 - 0.01 * log(100) / 0.99)
    assert abs(variance - truncated) < 0.06 * truncated


@pytest.mark.parametrize("roll", [surfaces.rolled_cylinder, surfaces.rolled_cone])
def test_a_plane_rolled_up_is_smoothed_like_the_plane(roll):
    flat, faces = surfaces.plane(24, 24, 0.02)
    flat = flat + np.array([0.5, 0.5, 0])
    colours = np.random.default_rng(3).random((len(flat), 3))
    curved = roll(flat, 0.5)
    h = surfaces.mean_edge_length(flat, faces)
    a = one_iteration(flat / h, faces, colours, 3.0, 1.0)
    b = one_iteration(curved / h, faces, colours, 3.0, 1.0)
    # Chords are shorter than arcs by (h / r)^2 / 24, below 1e-4; a sample in 20 at the cut-off may flip: 0.01 / 20.
    assert np.abs(a - b).mean() < 2e-4
    assert np.abs(a - b).max() < 5e-3


def test_area_weights_undo_uneven_sampling():
    """On a plane that is sampled twice as densely on one side, a blob at the border keeps its centre of mass."""
    left, right = np.arange(-12, 0.5, 0.5), np.arange(1, 13, 1.0)
    xs, ys = np.concatenate([left, right]), np.arange(-8, 9, 1.0)
    grid_x, grid_y = np.meshgrid(xs, ys)
    positions = np.column_stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)])
    faces = surfaces.grid_faces(len(ys), len(xs))
    ramp = 0.5 + grid_x.ravel()[:, None] / 40
    middle = (np.abs(grid_x) < 0.25).ravel() & (np.abs(grid_y) < 1).ravel()
    kwargs = {"beta": 0.0, "iterations": 1, "t": 2.0, "units": "world", "space": "data"}
    uniform = beltrami_cli.smooth(positions, faces, ramp, weights="uniform", **kwargs).colours
    area = beltrami_cli.smooth(positions, faces, ramp, weights="area", **kwargs).colours
    # A ramp is in balance when samples count by their area; uniformly the dense side pulls.
    assert np.abs(area - ramp)[middle].max() < 0.2 * np.abs(uniform - ramp)[middle].max()


def test_world_units_scale_with_the_mesh():
    positions, faces = surfaces.lattice(20, 20, 0.37)
    colours = np.random.default_rng(0).random((len(positions), 3))
    h = surfaces.mean_edge_length(positions, faces)
    spacing = beltrami_cli.smooth(positions, faces, colours, t=1.0, beta=4.0).colours
    world = beltrami_cli.smooth(positions, faces, colours, t=h * h, beta=4 * h, units="world").colours
    require_same(spacing, world)


@pytest.mark.slow
def test_isolated_vertices_and_meshes_without_faces_stay_and_change_nothing_elsewhere():
    positions, faces = surfaces.terrain(20, 25, 0.3, 1)
    random = np.random.default_rng(3)
    colours = (0.5 + 0.1 * random.standard_normal((len(positions), 3))).astype(np.float32)
    # With patches the noise is given: the last bits of its estimate, a sum over more vertices, decide ties of groups.
    for patches, noise, count in (("off", None, 9 * len(positions)), ("on", "25/255", 3)):
        options = {"beta": 8, "patches": patches, "noise": noise}
        strays, more = 1000 + random.random((count, 3)), random.random((count, 3))
        plain = beltrami_cli.smooth(positions, faces, colours, **options).colours
        places, shades = np.concatenate([positions, strays]), np.concatenate([colours, more])
        both = beltrami_cli.smooth(places, faces, shades, **options).colours
        require_same(both[: len(plain)], plain)
        np.testing.assert_allclose(both[len(plain) :], more, atol=1e-6)
    nothing = beltrami_cli.smooth(positions, np.empty((0, 3), int), colours)
    assert np.array_equal(nothing.colours, colours)


def test_a_kernel_that_meets_the_guard_is_counted_and_one_sample_changes_nothing():
    positions, faces = surfaces.plane(10, 10)
    colours = np.random.default_rng(0).random((100, 3)).astype(np.float32)
    cut = beltrami_cli.smooth(positions, faces, colours, beta=0, t=5, max_samples=1, iterations=2)
    assert cut.truncated == 200
    assert cut.samples_per_kernel == 1
    assert np.array_equal(cut.colours, colours)
    assert beltrami_cli.smooth(positions, faces, colours, beta=0, t=5).truncated == 0


def test_the_threshold_bounds_the_kernel():
    positions, faces = surfaces.plane(41, 41)
    colours = np.zeros((len(positions), 1))
    for threshold in (0.5, 0.1, 0.01):
        held = beltrami_cli.smooth(
            positions, faces, colours, beta=0, t=2, units="world", threshold=threshold, iterations=1
        )
        # Without borders a disc of radius^2 = -4 t ln threshold holds pi radius^2 samples of area 1.
        disc = np.pi * -8 * log(threshold)
        assert 0.75 * disc * (1 - 0.06 * disc**0.5) < held.samples_per_kernel < 1.1 * disc


def test_many_iterations_of_a_growing_beta_do_not_overflow():
    positions, faces = surfaces.terrain(12, 12, 0.3, 1)
    colours = np.random.default_rng(8).random((len(positions), 3))
    parameters = {"beta": 8.0, "beta_growth": 3.0, "t": 1.0, "metric_steps": 0}
    smooth = functools.partial(beltrami_cli.smooth, positions, faces, colours, **parameters)
    many, more = smooth(iterations=60), smooth(iterations=1500)
    assert np.isfinite(more.colours).all()
    assert np.array_equal(more.colours, many.colours)  # by then no neighbour is near
