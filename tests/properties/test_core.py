"""The core by itself: kernels on one grid of cells, patches of a surface, and the order of vertices in memory."""

from math import log

import numpy as np
import pytest

from beltrami_cli._native import (
    PATCH_BLOCK_SIZE,
    SurfacePatches,
    collaborate_on_grid,
    grid_distances,
    local_scale,
    morton_order,
    smooth_grid,
    vertex_order,
)
from oracles import surfaces
from properties.textured_planes import phantom

RANDOM = np.random.default_rng(1)


def grid(side):
    kind = np.ones((side, side), np.uint8)
    lengths = np.full((4, side, side), np.inf, np.float32)
    lengths[0, :, :-1] = lengths[1, :-1] = 1
    lengths[2, :-1, :-1] = lengths[3, :-1, 1:] = 2
    return kind, lengths


def test_the_unit_of_length_is_a_geometric_mean():
    """Over a window of 5 x 5, as NumPy takes it; logarithms of up to 18 are off by 2e-7 of that, twice over."""
    random = np.random.default_rng(4)
    right, below = np.exp(random.uniform(-18, 18, (2, 23, 31))).astype(np.float32)
    for lengths in (right, below):
        lengths[random.random(lengths.shape) < 0.3] = np.inf
        lengths[random.random(lengths.shape) < 0.1] = 0
    right[:8, :9] = below[:8, :9] = np.inf
    scale = local_scale(right, below, 2)
    for row, column in np.ndindex(23, 31):
        window = slice(max(0, row - 2), row + 3), slice(max(0, column - 2), column + 3)
        around = np.concatenate([right[window].ravel(), below[window].ravel()]).astype(float)
        around = around[np.isfinite(around) & (around > 0)]
        expected = np.exp(-np.log(around).mean()) if len(around) else 1.0
        assert scale[row, column] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("beta", "t", "mean", "most"), [(5.0, 0.8, 6e-7, 1.2e-3), (13.0, 2.2, 4e-5, 5e-3)])
@pytest.mark.parametrize("window", [3, 7, 11, 15])
def test_window_sweeps_agree_with_the_heap_march(beta, t, mean, most, window):
    """One outward pass misses paths that bend around colour edges; they are rare, and long, so they weigh little."""
    kind, lengths = grid(64)
    noisy = np.ascontiguousarray(phantom(64).transpose(2, 0, 1), np.float32)
    parameters = (beta, t, float(np.sqrt(-4 * t * log(0.01))), window // 2)
    swept, marched = (
        smooth_grid(kind, lengths, None, None, noisy, noisy, *parameters, scheme, 1, None)[0]
        for scheme in ("sweep", "triangles")
    )
    assert np.abs(swept - marched).mean() < mean
    assert np.abs(swept - marched).max() < most


@pytest.mark.parametrize("scheme", ["triangles", "metric", "sweep"])
@pytest.mark.parametrize("shear", [0.0, 0.5])
def test_every_scheme_smooths_by_a_gaussian_on_a_sheared_plane(scheme, shear):
    """Where the grid is sheared its quadrants are obtuse; the metric splits them."""
    side, t = 41, 1.5
    kind, lengths = grid(side)
    e1, e2 = np.array([1.0, 0.0]), np.array([shear, 1.0])
    for plane, step in zip(lengths, (e1, e2, e1 + e2, e2 - e1), strict=True):
        plane[np.isfinite(plane)] = step @ step
    impulse = np.zeros((1, side, side), np.float32)
    impulse[0, 20, 20] = 1
    radius = float(np.sqrt(-4 * t * log(0.001)))
    parameters = (0.0, t, radius, 0 if scheme != "sweep" else 7)
    ours, _ = smooth_grid(kind, lengths, None, None, impulse, impulse, *parameters, scheme, 1, None)
    y, x = np.mgrid[-20:21, -20:21]
    away = (x[..., None] * e1 + y[..., None] * e2) ** 2 @ [1, 1]
    truth = np.where(away <= radius**2, np.exp(-away / (4 * t)), 0)
    truth /= truth.sum()
    # First-order distances at a point source are too long by up to 10 % a few steps away: d^2 / 4t by 20 %.
    assert np.abs(ours[0] - truth).max() < 0.2 * truth.max()
    assert np.abs(ours[0] - truth).sum() < 0.25


@pytest.mark.parametrize("scheme", ["triangles", "metric", "sweep"])
def test_a_cell_that_repeats_a_texel_counts_for_its_share(scheme):
    """A linear kernel of shares w is that of w I over that of w."""
    kind, lengths = grid(30)
    repeats = RANDOM.integers(1, 5, kind.shape).astype(np.uint8)
    repeats[:, :15] = 1  # of samples: only what lies beyond a seam is repeated
    kind[:, 15:] = np.where(kind[:, 15:] == 1, 2, kind[:, 15:])
    colours = np.ascontiguousarray(phantom(30).transpose(2, 0, 1), np.float32)
    shares = (1 / repeats).astype(np.float32)
    both = np.concatenate([colours * shares, shares[None]])
    more = (0.0, 1.5, 5.0, 3, scheme, 1, None)
    result, _ = smooth_grid(kind, lengths, None, repeats, colours, colours, *more)
    parts, _ = smooth_grid(kind, lengths, None, None, both, both, *more)
    owned = kind == 1
    assert np.abs(result - parts[:3] / parts[3])[:, owned].max() < 2e-6  # rounding of sums of 49
    assert np.abs(result - smooth_grid(kind, lengths, None, None, colours, colours, *more)[0]).max() > 1e-3


@pytest.mark.parametrize("scheme", ["triangles", "metric", "sweep"])
@pytest.mark.parametrize(("rows", "columns", "radius"), [(1, 1, 1), (1, 90, 4), (37, 1, 2), (40, 70, 7)])
def test_grids_of_any_shape_with_holes_are_averaged_by_the_distances_of_single_kernels(
    scheme, rows, columns, radius
):
    """Colours of cells that are not owned stay, and the number of threads makes no difference."""
    random = np.random.default_rng(11)
    kind = random.choice(np.array([0, 1, 2], np.uint8), (rows, columns), p=(0.12, 0.76, 0.12))
    lengths = random.uniform(0.1, 3, (4, rows, columns)).astype(np.float32)
    lengths[random.random(lengths.shape) < 0.1] = np.inf
    lengths[:, kind == 0] = np.inf
    colours = random.random((2, rows, columns), np.float32)
    scale, t, reach, beta = local_scale(lengths[0], lengths[1], 3), 1.5, 5.0, 4.0
    one, other = (
        smooth_grid(
            kind, lengths, scale, None, colours, colours, beta, t, reach, radius, scheme, threads, None
        )[0]
        for threads in (1, 3)
    )
    assert np.array_equal(one, other)
    assert np.array_equal(one[:, kind != 1], colours[:, kind != 1])
    padded = np.pad(colours.astype(float), ((0, 0), (radius, radius), (radius, radius)))
    for cell in np.flatnonzero(kind == 1)[::97].tolist():
        distances = grid_distances(kind, lengths, scale, colours, beta, reach, radius, scheme, cell)
        kernel = np.exp(-np.square(distances, dtype=float) / (4 * t))
        row, column = divmod(cell, columns)
        around = padded[:, row : row + 2 * radius + 1, column : column + 2 * radius + 1]
        mean = (kernel * around).sum(axis=(1, 2)) / kernel.sum()
        np.testing.assert_allclose(one[:, row, column], mean, atol=1e-5)


@pytest.mark.parametrize("has_pilot", [False, True])
@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 9), (12, 3), (200, 140)])
def test_patches_of_grids_with_holes_estimate_owned_cells_and_leave_the_pilot_elsewhere(
    rows, columns, has_pilot
):
    """Empty cells are not read, and neither threads nor estimates in the place of the pilot make a difference."""
    random = np.random.default_rng(23)
    kind = random.choice(np.array([0, 1, 2], np.uint8), (rows, columns), p=(0.05, 0.9, 0.05))
    x = np.arange(columns) * np.ones((rows, 1))
    pilot = np.float32([0.5 + 0.3 * np.sin(x / 4 + c) for c in range(3)])
    noisy = pilot + random.normal(0, 0.1, pilot.shape).astype(np.float32)
    noisy[:, kind == 0] = pilot[:, kind == 0] = np.nan
    forth = np.float32([[1, 0.5, 0.5], [0, 1, 0], [0, 0, 1]])
    back, ones = np.linalg.inv(forth).astype(np.float32), np.ones(3, np.float32)
    mixing, relative = (forth, back, ones / 100, 2 * ones, 0.0, 1.0), np.ones((rows, columns), np.float32)
    results = []
    for threads, varies in ((1, False), (2, False), (3, True)):
        found, before = np.empty_like(pilot), pilot.copy()
        found = before if threads == 2 else found
        variances = relative if varies else None
        collaborate_on_grid(kind, noisy, before, mixing, variances, has_pilot, found, threads, None)
        results.append(found)
    for found in results:
        np.testing.assert_array_equal(found, results[0])
    owned = kind == 1
    np.testing.assert_array_equal(found[:, ~owned], pilot[:, ~owned])
    assert np.abs(found - 0.5)[:, owned].max(initial=0) < 0.8
    assert (found != pilot)[:, owned].all()


def sheets(side, count):
    """Sheets of jittered vertices close above one another, which no edge joins, and a vertex without edges."""
    random = np.random.default_rng(27)
    flat, faces = surfaces.plane(side, side)
    positions = np.concatenate([flat + random.uniform(0, 0.25, flat.shape) * [1, 1, 0] for _ in range(count)])
    positions[:, 2] = 0.05 * np.repeat(np.arange(count), side * side)
    faces = np.concatenate([faces + sheet * side * side for sheet in range(count)]).astype(np.int32)
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)), axis=0)
    return np.vstack([positions, [0.5, 0.5, 0]]), edges


def collaborated(
    positions, edges, colours, threads=1, progress=None, axes=((1, 0.2, 0), (0, 1, 0)), blocks=None
):
    """Return the estimates without and with a pilot."""
    priorities = np.random.default_rng(3).integers(0, 1 << 63, len(positions)).astype(np.uint64)
    patches = SurfacePatches(positions, edges, np.array(axes), priorities, threads, blocks)
    pilot, one = colours + np.float32(0.01), np.full(3, 0.01, np.float32)
    mixing = np.eye(3, dtype=np.float32), np.eye(3, dtype=np.float32), one, 200 * one, 0.0, 1.0
    results = []
    for has_pilot in (False, True):
        estimates, weights = np.zeros_like(colours), np.zeros_like(colours)
        patches.collaborate(colours, pilot, mixing, None, has_pilot, estimates, weights, threads, progress)
        results.append(np.divide(estimates, weights, where=weights > 0, out=pilot.copy()))
    assert all(np.array_equal(found[-1], pilot[-1]) for found in results)  # the vertex without edges
    return np.array(results)


@pytest.mark.parametrize(
    "axes", [((1, 0.2, 0), (0, 1, 0)), ((0.1, 0, 1), (1, 0.3, 0))], ids=["along", "upright"]
)
def test_patches_stay_on_their_sheet_whatever_the_order_of_edges_and_the_number_of_threads(axes):
    side = 40
    positions, edges = sheets(side, 2)
    colours = np.full((len(positions), 3), 1000, np.float32)
    colours[: side * side] = np.random.default_rng(1).normal(0.5, 0.1, (side * side, 3))
    found = collaborated(positions, edges, colours, axes=axes)
    assert np.abs(found[:, : side * side] - 0.5).max() < 0.8
    for threads in (2, 3):
        assert np.array_equal(collaborated(positions, edges, colours, threads, axes=axes), found)
    shuffled = np.random.default_rng(2).permutation(edges)
    # Sums are taken in another order.
    np.testing.assert_allclose(
        collaborated(positions, shuffled, colours, axes=axes), found, rtol=1e-5, atol=1e-5
    )


def test_blocks_of_vertices_are_summed_as_by_default_and_those_without_a_number_start_no_group():
    positions, edges = sheets(50, 2)
    colours = np.random.default_rng(1).random((len(positions), 3), np.float32)
    blocks = (np.arange(len(positions)) // PATCH_BLOCK_SIZE).astype(np.int32)
    whole = collaborated(positions, edges, colours)
    assert np.array_equal(collaborated(positions, edges, colours, blocks=blocks), whole)
    blocks[2500:] = -1  # of the second sheet, whose vertices get the pilot
    part = collaborated(positions, edges, colours, blocks=blocks)
    assert np.array_equal(part[:, :2500], whole[:, :2500])
    assert np.array_equal(part[:, 2500:], np.stack([colours + np.float32(0.01)] * 2)[:, 2500:])


@pytest.mark.parametrize("side", [1, 2, 3, 5])
@pytest.mark.parametrize("extent", [0.0, 1.0], ids=["at one place", "on a plane"])
def test_patches_of_small_surfaces_and_of_vertices_at_one_place_have_an_estimate(side, extent):
    positions, edges = sheets(side, 2)
    colours = np.random.default_rng(1).random((len(positions), 3), np.float32)
    assert np.isfinite(collaborated(extent * positions, edges, colours)).all()


def test_what_progress_raises_ends_the_work_of_all_threads():
    def stop(done):
        raise KeyboardInterrupt

    positions, edges = sheets(20, 1)
    colours = np.zeros((len(positions), 3), np.float32)
    kind, lengths = grid(64)
    planes = np.zeros((1, 64, 64), np.float32)
    with pytest.raises(KeyboardInterrupt):
        collaborated(positions, edges, colours, 2, stop)
    with pytest.raises(KeyboardInterrupt):
        smooth_grid(kind, lengths, None, None, planes, planes, 1.0, 1.0, 4.0, 3, "sweep", 2, stop)


def scattered(side):
    """A lattice whose vertices lie anywhere, with a third triangle at many edges; in any order."""
    random = np.random.default_rng(0)
    _, faces = surfaces.lattice(side, side)
    corners = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([faces, np.column_stack([corners, corners + 1, corners + side + 1])])
    order = random.permutation(side * side)
    return random.standard_normal((side * side, 3)), order[faces].astype(np.int32)


def share_of_near(order, faces, within):
    """Return how many sides of faces have both ends so close in memory."""
    rank = np.argsort(order)
    return np.mean(np.abs(rank[faces] - rank[np.roll(faces, 1, axis=1)]) <= within)


def test_even_surfaces_are_ordered_along_a_curve_through_space():
    positions, faces = surfaces.terrain(70, 70, 0.3, 1)
    order = np.random.default_rng(0).permutation(len(positions))
    positions, faces = positions[order], np.argsort(order)[faces].astype(np.int32)
    assert np.array_equal(vertex_order(positions, faces), morton_order(positions))


def test_neighbours_lie_close_in_memory_wherever_they_lie_in_space():
    side = 100
    positions, faces = scattered(side)
    order = vertex_order(positions, faces)
    assert np.array_equal(np.sort(order), np.arange(side * side))
    assert share_of_near(morton_order(positions), faces, 2 * side) < 0.1
    # Breadth first, fronts are no longer than the lattice's sides both together, and neighbours at most a front apart.
    assert share_of_near(order, faces, 2 * side) > 0.9


@pytest.mark.parametrize(
    "faces", [np.zeros((0, 3)), [[0, 0, 0]], [[3, 1, 2], [9, 8, 8]]], ids=["none", "a point", "two parts"]
)
def test_vertices_of_no_face_and_of_any_part_are_kept(faces):
    positions = np.random.default_rng(0).standard_normal((10, 3))
    order = vertex_order(positions, np.asarray(faces, np.int32))
    assert np.array_equal(np.sort(order), np.arange(10))


@pytest.mark.parametrize("corner", [-1, 10])
def test_corners_that_are_no_vertices_are_refused(corner):
    with pytest.raises(ValueError, match="not there"):
        vertex_order(np.zeros((10, 3)), np.array([[0, 1, corner]], np.int32))
