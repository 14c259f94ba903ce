"""Passes of the core over canvases and vertices, against NumPy and SciPy."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from scipy.sparse import coo_array

from beltrami_cli._native import convolve, neighbour_means


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
