"""The core by itself: kernels on one grid of cells, and the order of vertices in memory."""

from math import log

import numpy as np
import pytest

from beltrami_cli._native import local_scale, morton_order, smooth_grid, vertex_order
from oracles import surfaces
from properties.textured_planes import painting

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
    noisy = np.ascontiguousarray(painting(64).transpose(2, 0, 1), np.float32)
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
    colours = np.ascontiguousarray(painting(30).transpose(2, 0, 1), np.float32)
    shares = (1 / repeats).astype(np.float32)
    both = np.concatenate([colours * shares, shares[None]])
    more = (0.0, 1.5, 5.0, 3, scheme, 1, None)
    result, _ = smooth_grid(kind, lengths, None, repeats, colours, colours, *more)
    parts, _ = smooth_grid(kind, lengths, None, None, both, both, *more)
    owned = kind == 1
    assert np.abs(result - parts[:3] / parts[3])[:, owned].max() < 2e-6  # rounding of sums of 49
    assert np.abs(result - smooth_grid(kind, lengths, None, None, colours, colours, *more)[0]).max() > 1e-3


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
