"""Which cells of a canvas are near covered ones."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from beltrami_cli.surface.atlas import within


@pytest.mark.parametrize("reach", [0, 1, 2, 5, 13, 40])
def test_cells_are_near_up_to_the_edges_of_the_canvas(reach):
    covered = np.random.default_rng(reach).random((60, 45)) < 0.005
    covered[[0, 11, 23, 23], [0, 17, 3, 39]] = True
    assert np.array_equal(within(covered, reach), maximum_filter(covered, 2 * reach + 1, mode="constant"))
