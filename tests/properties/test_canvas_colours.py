"""Colours put on canvases, taken from them and smoothed for the metric, against SciPy and NumPy."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d, maximum_filter

from beltrami_cli._native import convolve, put_colours, take_colours
from beltrami_cli.pipeline.textures.repainting import within


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


@pytest.mark.parametrize("kind", [np.int32, np.int64])
@pytest.mark.parametrize("threads", [1, 4])
def test_colours_come_back_from_the_cells_they_were_put_in(kind, threads):
    random = np.random.default_rng(2)
    planes = np.full((2, 300, 200), -1, np.float32)
    cells = np.sort(random.permutation(60_000)[:25_000]).astype(kind)
    colours = random.random((len(cells), 2), np.float32)
    put_colours(planes, cells, colours, threads)
    expected = np.full((2, 60_000), -1, np.float32)
    expected[:, cells] = colours.T
    np.testing.assert_array_equal(planes.reshape(2, -1), expected)
    back = np.empty_like(colours)
    take_colours(planes, cells, back, threads)
    np.testing.assert_array_equal(back, colours)


@pytest.mark.parametrize("cell", [-1, 6])
def test_a_cell_outside_the_canvas_is_refused_and_nothing_written(cell):
    planes = np.zeros((1, 2, 3), np.float32)
    with pytest.raises(IndexError, match="outside the canvas"):
        put_colours(planes, np.array([0, cell]), np.ones((2, 1), np.float32), 1)
    assert not planes.any()


@pytest.mark.parametrize("reach", [0, 1, 2, 5, 13, 40])
def test_what_is_within_some_texels_is_what_a_maximum_filter_finds(reach):
    covered = np.random.default_rng(reach).random((60, 35)) < 0.01
    expected = maximum_filter(covered, 2 * reach + 1, mode="constant")
    np.testing.assert_array_equal(within(covered, reach), expected)
