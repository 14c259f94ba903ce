"""Colours scattered to canvases and gathered from them, against NumPy and SciPy."""

import numpy as np
import pytest

from beltrami_cli._native import gather_colours, scatter_colours


@pytest.mark.parametrize("kind", [np.int32, np.int64])
@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("channels", [2, 3])
@pytest.mark.parametrize("ordered", [True, False])
def test_colours_come_back_from_the_cells_they_were_scattered_to(kind, threads, channels, ordered):
    random = np.random.default_rng(2)
    planes = np.full((channels, 300, 200), -1, np.float32)
    holes = random.permutation(60_000)[:1_000]  # so there are runs of some sixty cells
    cells = np.delete(np.arange(60_000), holes).astype(kind)
    if not ordered:
        cells = random.permutation(cells)
    colours = random.random((len(cells), channels), np.float32)
    scatter_colours(planes, cells, colours, threads)
    expected = np.full((channels, 60_000), -1, np.float32)
    expected[:, cells] = colours.T
    np.testing.assert_array_equal(planes.reshape(channels, -1), expected)
    back = np.empty_like(colours)
    gather_colours(planes, cells, back, threads)
    np.testing.assert_array_equal(back, colours)


@pytest.mark.parametrize("cell", [-1, 6])
def test_a_cell_outside_the_canvas_is_refused_and_nothing_written(cell):
    planes = np.zeros((1, 2, 3), np.float32)
    with pytest.raises(IndexError, match="outside the canvas"):
        scatter_colours(planes, np.array([0, cell]), np.ones((2, 1), np.float32), 1)
    assert not planes.any()
