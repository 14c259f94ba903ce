"""Distances by fast marching and along segments, and kernels along segments, against truths that are not our code."""

from math import log, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.flow.parameters import KernelParameters
from oracles import strategies, surfaces
from oracles.geodesics import Manifold, exact_distances, graph_distances
from properties.manifolds import apply_kernel, distances, image_manifold, segment_manifold


@pytest.mark.slow
@given(strategies.coloured_meshes(strategies.meshes(general=True)))
@settings(max_examples=75, deadline=None)
def test_distances_equal_those_of_a_textbook_march_on_any_mesh(mesh):
    positions, faces, colours = mesh
    manifold = image_manifold(positions, faces, colours, 2.0)
    oracle = Manifold(np.hstack([positions, 2.0 * colours.astype(float)]), faces)
    for source in range(len(positions)):
        ours, truth = distances(manifold, len(positions), source), oracle.distances(source)
        # Lengths are rounded to float32 once (6e-8) and a path adds up a dozen; near-degenerate triangles
        # amplify the rounding of heights, which enter by their squares: its root is 2.4e-4.
        np.testing.assert_allclose(ours, truth, rtol=1e-3, atol=1e-5)


def test_the_march_stops_at_the_radius_and_loses_nothing_within():
    positions, faces = surfaces.icosphere(3)
    colours = np.random.default_rng(2).random((len(positions), 2))
    manifold = image_manifold(positions, faces, colours, 0.5)
    everything = distances(manifold, len(positions), 7)
    within = distances(manifold, len(positions), 7, radius=0.6)
    assert np.array_equal(np.isfinite(within), everything <= np.float32(0.6))
    assert np.array_equal(within[np.isfinite(within)], everything[np.isfinite(within)])


@pytest.mark.parametrize("manifold", [image_manifold, segment_manifold])
@pytest.mark.parametrize("corner", [-1, 3])
def test_manifolds_of_faces_without_such_a_vertex_are_refused(manifold, corner):
    with pytest.raises(ValueError, match="not there"):
        manifold(np.zeros((3, 3)), [[0, 1, corner]], np.zeros((3, 1)), 0.0)


def plain_sums(manifold, colours, t, weights=None, max_samples=10**6, threshold=0.01):
    """Eqs. (8, 9) in double precision, kernel by kernel, with the distances of single marches."""
    smoothed, radius = np.empty(colours.shape), sqrt(-4 * t * log(threshold))
    for source in range(len(colours)):
        held, away = manifold.distances(source, radius, max_samples)
        kernel = np.exp(-(away.astype(float) ** 2) / (4 * t)) * (1 if weights is None else weights[held])
        smoothed[source] = kernel @ colours[held] / kernel.sum()
    return smoothed


@pytest.mark.parametrize("manifold", [image_manifold, segment_manifold])
def test_kernels_of_some_vertices_are_those_of_all(manifold):
    positions, faces = surfaces.terrain(30, 30, 0.3, 1)
    colours = np.random.default_rng(8).random((len(positions), 3)).astype(np.float32)
    own = manifold(positions, faces, colours, 1.0)
    whole, part = (
        own.smooth(colours, None, 1.0, 4.3, 1000, 1, None),
        own.smooth(colours, None, 1.0, 4.3, 1000, 2, None, 101, 700),
    )
    assert np.array_equal(part[0][101:700], whole[0][101:700])
    assert part[1] <= whole[1]


@pytest.mark.slow
@given(strategies.coloured_meshes(strategies.meshes(general=True)))
@settings(max_examples=20, deadline=None)  # each makes a graph of 30 points an edge, which is what takes time
def test_distances_lie_between_geodesics_and_paths_over_edges_on_any_mesh(mesh):
    positions, faces, colours = mesh
    manifold = segment_manifold(positions, faces, colours, 2.0)
    embedded = np.hstack([positions, 2.0 * colours.astype(float)])
    over_edges = graph_distances(embedded, faces, extra=0)
    nearly_geodesic = graph_distances(embedded, faces, extra=30)
    # A path of the graph crosses edges at these points only, at most half a gap away, which makes it longer by at most
    # a gap; a segment of ours crosses two edges, and what more segments make is less than 4 %.
    gap = np.linalg.norm(embedded[faces] - embedded[np.roll(faces, 1, axis=1)], axis=2).max(initial=0) / 31
    for source in range(len(positions)):
        ours = distances(manifold, len(positions), source)
        # Rounding of squared heights in needles, whose root is 2.4e-4 of their length.
        scale = 1e-3 * np.where(np.isfinite(over_edges[source]), over_edges[source], 0) + 1e-5
        assert (ours <= over_edges[source] + scale).all()
        assert (ours >= 0.96 * nearly_geodesic[source] - 2 * gap - scale)[np.isfinite(ours)].all()


@given(strategies.coloured_meshes(strategies.meshes(general=True)), st.sampled_from((0.05, 5.0)))
@settings(max_examples=40, deadline=None)
def test_kernels_side_by_side_are_those_of_single_marches_on_any_mesh(mesh, t):
    positions, faces, colours = mesh
    weights = np.random.default_rng(0).random(len(positions)).astype(np.float32) + 0.1
    manifold = segment_manifold(positions, faces, colours, 2.0)
    radius = sqrt(-4 * t * log(0.01))
    held = np.array([len(manifold.distances(v, radius, 10**6)[0]) for v in range(len(positions))])
    ours, samples, truncated = apply_kernel(manifold, colours, t, weights)
    np.testing.assert_allclose(ours, plain_sums(manifold, colours, t, weights), atol=1e-5)
    assert (samples, truncated) == (held.sum(), 0)
    _, samples, truncated = apply_kernel(manifold, colours, t, weights, max_samples=3)
    assert (samples, truncated) == (np.minimum(held, 3).sum(), (held > 3).sum())


@pytest.mark.slow
@pytest.mark.parametrize(("t", "most"), [(1.0, 12), (60.0, 10**6), (60.0, 500)])
def test_kernels_of_any_size_are_those_of_single_marches(t, most):
    """Small, beyond what sources share, and cut short."""
    positions, faces = surfaces.terrain(36, 36, 0.3, 1)
    require_single_marches(positions, faces, t, most)


@pytest.mark.parametrize("by_place", [False, True], ids=["mean spacing", "local spacing"])
def test_kernels_where_lengths_of_edges_vary_strongly_are_those_of_single_marches(by_place):
    flat, faces = surfaces.lattice(40, 40)
    positions = surfaces.graded(flat, 8)
    sides = np.linalg.norm(positions[faces] - positions[np.roll(faces, 1, axis=1)], axis=2)
    scales = None
    if by_place:
        sums, counts = np.zeros(len(positions)), np.bincount(faces.ravel())
        np.add.at(sums, faces, sides[:, :1] / sides.mean())
        scales = (counts / sums).astype(np.float32)
    require_single_marches(positions / sides.mean(), faces, 0.7, 10**6, scales)


def require_single_marches(positions, faces, t, most, scales=None):
    colours = np.random.default_rng(0).random((len(positions), 2)).astype(np.float32)
    manifold = segment_manifold(positions, faces, colours, 1.0)
    manifold.update_metric(np.ascontiguousarray(positions), colours, 1.0, scales, 1)
    ours, samples, truncated = apply_kernel(manifold, colours, t, max_samples=most)
    # Two samples whose distances are the same to the last bit may change places at the cut.
    np.testing.assert_allclose(ours, plain_sums(manifold, colours, t, max_samples=most), atol=1e-5)
    assert (truncated > 0) == (most < 1000)
    assert samples > 10 * len(positions)


def test_a_vertex_that_all_others_are_neighbours_of_is_like_any():
    """More segments come from it than places can be counted with sixteen bits."""
    count = 40_000
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.arange(1, count + 1)
    positions = np.vstack([[0, 0, 0], np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])])
    faces = np.column_stack([np.zeros(count, int), rim, np.roll(rim, -1)])
    colours = np.random.default_rng(0).random((count + 1, 1)).astype(np.float32)
    manifold = segment_manifold(positions, faces, colours, 0.0)
    ours, samples, truncated = apply_kernel(manifold, colours, 0.1, max_samples=50)
    assert (samples, truncated) == (50 * (count + 1), count + 1)
    for vertex in (0, 1, count // 2):
        held, away = manifold.distances(vertex, sqrt(-0.4 * log(0.01)), 50)
        kernel = np.exp(-(away.astype(float) ** 2) / 0.4)
        np.testing.assert_allclose(ours[vertex], kernel @ colours[held] / kernel.sum(), atol=1e-5)


def test_lengths_that_change_in_space_are_noticed():
    positions, faces = surfaces.terrain(40, 45, 0.3, 1)
    colours = np.random.default_rng(8).random((len(positions), 3)).astype(np.float32)
    manifold = segment_manifold(4 * positions, faces, colours, 1.0)
    apply_kernel(manifold, colours, 0.7)
    manifold.update_metric(positions, colours, 1.0, None, 1)
    fresh = segment_manifold(positions, faces, colours, 1.0)
    assert np.array_equal(apply_kernel(manifold, colours, 0.7)[0], apply_kernel(fresh, colours, 0.7)[0])
    scales = np.full(len(positions), 0.5, np.float32)
    manifold.update_metric(positions, colours, 1.0, scales, 1)
    halved = segment_manifold(positions / 2, faces, colours, 1.0)
    expected = apply_kernel(halved, colours, 0.7)[0]
    np.testing.assert_allclose(apply_kernel(manifold, colours, 0.7)[0], expected, atol=1e-5)


def test_segments_are_the_default_as_far_as_they_are_the_more_exact():
    for radius, along in ((10, True), (20, False)):
        t = radius**2 / (-4 * log(0.01))
        assert KernelParameters(t=t).is_along_segments(1.0) == along
        assert KernelParameters(t=4 * t).is_along_segments(2.0) == along
        assert KernelParameters(t=t, solver="segments").is_along_segments(1.0)
        assert not KernelParameters(t=t, solver="fast-marching").is_along_segments(1.0)


def noisy_surface(beta=5.0, side=15, seed=0):
    """A grey image on a lattice that is not quite regular, noise of 20/255: (flat, faces, grey, embedded)."""
    random = np.random.default_rng(seed)
    flat, faces = surfaces.lattice(side, side)
    flat = flat + np.pad(0.1 * random.standard_normal((len(flat), 2)), ((0, 0), (0, 1)))
    # Three channels have 1.7 times the differences of one.
    grey = (0.5 + sqrt(3) * 20 / 255 * random.standard_normal((len(flat), 1))).astype(np.float32)
    return flat, faces, grey, np.column_stack([flat[:, :2], beta * grey.astype(float)])


@pytest.mark.parametrize("samples", [20, 50])
@pytest.mark.parametrize("beta", [2.0, 5.0, 13.0])
def test_distances_have_at_most_half_the_error_of_fast_marching(samples, beta, record_property):
    errors = {"segments": [], "marching": []}
    for seed in range(6):
        flat, faces, grey, embedded = noisy_surface(beta, seed=seed)
        middle = 7 * 15 + 7
        truth = exact_distances(embedded, faces, middle)
        near = np.argsort(truth)[1:samples]
        for name, manifold in (
            ("segments", segment_manifold(flat, faces, grey, beta)),
            ("marching", image_manifold(flat, faces, grey, beta)),
        ):
            found = distances(manifold, len(flat), middle)
            errors[name].append(found[near] / truth[near] - 1)
    rms = {name: float(np.sqrt(np.mean(np.square(error)))) for name, error in errors.items()}
    for name, error in rms.items():
        record_property(f"rms error of {name}", float(error))
    # Paths on the surface are never shorter than the shortest; lengths are rounded to float32.
    assert np.min(errors["segments"]) > -1e-5
    assert rms["segments"] < 0.5 * rms["marching"]
