"""The table by which the noise model is judged."""

import numpy as np
import pytest

from oracles.pictures import photograph
from table import ROWS, SIDE, judge, on_grids, on_surfaces, truth_of


def crops():
    return [np.rint(255 * photograph(SIDE)).astype(np.uint8)]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_has_noise_unless_it_is_clean(row):
    made = list(on_grids(crops(), row))
    if row.on_surfaces is not None:
        made += on_surfaces(crops(), row)
    for neighbourhoods, planes, colours in made:
        assert neighbourhoods.count
        assert planes.shape[0] == 3
        assert np.isfinite(planes).all()
        assert (truth_of(colours) > 0.5 / 255) != row.is_clean


@pytest.mark.parametrize("kind", ["grid", "cluster"])
def test_folders_without_test_images_are_refused(kind, tmp_path):
    with pytest.raises(SystemExit, match="no image of the part test"):
        judge([tmp_path], "test", kind)
