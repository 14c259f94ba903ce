"""Passes of the core over canvases and vertices, against NumPy and SciPy."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from scipy.sparse import coo_array

from beltrami_cli._native import convolve, neighbour_means, pilot_of_graph, pilot_of_squares


@pytest.mark.parametrize("shape", [(3, 40, 70), (1, 1, 9), (2, 7, 1), (1, 2, 3)])
@pytest.mark.parametrize("count", [1, 3, 7])
def test_a_convolution_is_that_of_scipy_for_any_number_of_threads(shape, count):
    random = np.random.default_rng(1)
    planes = random.standard_normal(shape).astype(np.float32)
    taps = random.random(count).astype(np.float32)
    expected = [correlate1d(plane.astype(float), taps, 0, mode="constant") for plane in planes]
    expected = np.stack([correlate1d(plane, taps, 1, mode="constant") for plane in expected])
    smoothed = convolve(planes, taps, 1)
    # Each of the two sums has `count` terms, whose roundings are at most half a unit in the last place each.
    most = 2 * count * np.finfo(np.float32).eps * np.abs(planes).max() * taps.sum() ** 2
    np.testing.assert_allclose(smoothed, expected, rtol=0, atol=most)
    np.testing.assert_array_equal(convolve(planes, taps, 3), smoothed)


def test_means_over_neighbours_are_those_of_a_sparse_matrix():
    random = np.random.default_rng(3)
    count = 200
    edges = random.integers(0, count - 1, (900, 2)).astype(np.int32)  # the last vertex has none
    weights = random.random(len(edges)).astype(np.float32)
    values = random.standard_normal((count, 4)).astype(np.float32)
    matrix = coo_array((weights.astype(float), edges.T), (count, count))
    totals = 1 + (matrix + matrix.T).sum(axis=1)
    expected = (values + (matrix + matrix.T) @ values.astype(float)) / totals[:, None]
    means, others = (neighbour_means(values, edges, weights, totals, threads) for threads in (1, 3))
    # Sums are taken in double precision, and rounded once.
    np.testing.assert_allclose(means, expected, rtol=np.finfo(np.float32).eps, atol=1e-12)
    np.testing.assert_array_equal(means, others)


def test_an_edge_to_no_vertex_is_refused():
    values, edges = np.zeros((3, 1), np.float32), np.array([[0, 3]], np.int32)
    with pytest.raises(IndexError, match="no such vertex"):
        neighbour_means(values, edges, np.ones(1, np.float32), np.ones(3), 1)


def weigh(difference, limits):
    """Return the weights of J. Tukey's biweight."""
    square = np.square(difference).sum(axis=0)
    return np.square(np.maximum(1 - square / np.maximum(limits, 1e-6), 0))


def expected_pilot(colours, edges, variances):
    """Return what `pilot_of_graph` is to return, in double precision."""
    pilot, (one, other), count = colours.astype(float), edges.T, colours.shape[1]
    limits = 24 * np.broadcast_to(variances, count).astype(float)
    for number in range(3):
        difference = pilot[:, other] - pilot[:, one]
        weight = weigh(difference, (limits[one] + limits[other]) / 2 * 0.25**number)
        total = 1 + np.bincount(one, weight, count) + np.bincount(other, weight, count)
        for plane, own in zip(pilot, difference * weight, strict=True):
            plane += (np.bincount(one, own, count) - np.bincount(other, own, count)) / total
    return pilot


def pairs_of_squares(filled):
    """Return the pairs of cells of squares that are neighbours and filled, by flat indices."""
    numbers, pairs = np.arange(filled.size).reshape(filled.shape), []
    for one, other in (
        (np.s_[:, :, 1:], np.s_[:, :, :-1]), (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[:, 1:, 1:], np.s_[:, :-1, :-1]), (np.s_[:, 1:, :-1], np.s_[:, :-1, 1:]),
    ):  # fmt: skip
        both = filled[one] & filled[other]
        pairs.append(np.stack([numbers[one][both], numbers[other][both]], axis=1))
    return np.concatenate(pairs)


def noisy_colours(random, count):
    """Return colours with edges in steps of 8 bits, and their noise: variances of samples that differ by place."""
    variances = random.uniform(1, 200, count).astype(np.float32)
    clean = 60 * random.integers(0, 4, (3, count))
    return (clean + np.sqrt(variances) * random.standard_normal((3, count))).astype(np.float32), variances


# Three passes, each with some ten roundings of colours up to 300.
ROUNDINGS = 3 * 10 * 300 * np.finfo(np.float32).eps


@pytest.mark.parametrize("one_variance", [False, True])
def test_the_pilot_of_a_graph_is_that_of_numpy(one_variance):
    random = np.random.default_rng(4)
    edges = random.integers(0, 299, (900, 2))  # the last sample has none
    edges = edges[edges[:, 0] != edges[:, 1]]
    colours, variances = noisy_colours(random, 300)
    variances = variances[:1] if one_variance else variances
    pilot = pilot_of_graph(colours, edges, variances)
    np.testing.assert_allclose(pilot, expected_pilot(colours, edges, variances), rtol=0, atol=ROUNDINGS)
    np.testing.assert_array_equal(pilot[:, -1], colours[:, -1])
    assert np.abs(pilot - colours).max() > 1


@pytest.mark.parametrize("side", [1, 8, 13, 32])  # whole packs of numbers, and others
@pytest.mark.parametrize("is_filled", [False, True])
def test_the_pilot_of_squares_is_that_of_the_graph_of_their_cells(side, is_filled):
    random, shape = np.random.default_rng(5), (3, side, side)
    filled = np.ones(shape, bool) if is_filled else random.random(shape) < 0.7
    colours, variances = noisy_colours(random, filled.size)
    for own in (variances, variances[:1]):
        expected = expected_pilot(colours, pairs_of_squares(filled), own).reshape(3, *shape)
        pilot = pilot_of_squares(colours.reshape(3, *shape), None if is_filled else filled, own)
        np.testing.assert_allclose(pilot[:, filled], expected[:, filled], rtol=0, atol=ROUNDINGS)


def test_the_pilot_of_squares_is_the_same_to_the_last_bit_on_any_instruction_set(monkeypatch):
    colours, variances = noisy_colours(np.random.default_rng(6), 2 * 32 * 32)
    pilots = []
    for name in ("baseline", "x86-64-v3", "x86-64-v4"):
        monkeypatch.setenv("BELTRAMI_SIMD", name)
        try:
            pilots.append(pilot_of_squares(colours.reshape(3, 2, 32, 32), None, variances))
        except ValueError:
            continue  # this machine does not have it
    for pilot in pilots[1:]:
        np.testing.assert_array_equal(pilot, pilots[0])


def test_a_pilot_leaves_equal_colours_without_noise_as_they_are():
    colours, none = np.full((3, 2, 9, 9), 77.7, np.float32), np.zeros(1, np.float32)
    np.testing.assert_array_equal(pilot_of_squares(colours, None, none), colours)
    edges = np.array([[0, 1], [1, 2]])
    np.testing.assert_array_equal(pilot_of_graph(colours[:, 0, 0], edges, none), colours[:, 0, 0])
