"""Charts are packed by their shapes, and still keep their distance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from beltrami_cli.surface.atlas import EMPTY, build_atlas, grid_atlas
from oracles.textured import cube, quads, textured


def stairs(count, length=12, side=8):
    """Charts aslant, as long as wide stairs of squares: their boxes are nearly empty."""
    positions, faces, corners = [], [], []
    square, (square_faces) = quads(1, 1, side, np.zeros((1, 1)))
    for chart in range(count):
        for step in range(2 * length - 1):  # a stair: right, down, right, ...
            place = np.array([(step + 1) // 2, step // 2]) * side
            faces.append(square_faces + 4 * len(positions))
            positions.append(square + np.array([*place, 1000.0 * chart]))
            corners.append((square[:, :2] + place + [24 * chart, 4])[square_faces])
    size = (24 * count + length * side, length * side + 8)
    return textured(np.concatenate(positions), np.concatenate(faces), np.concatenate(corners), [size]), [size]


@pytest.mark.parametrize("margin", [1, 3, 5])
def test_charts_interlock_but_their_margins_do_not(margin):
    surface, sizes = stairs(9)
    atlas = build_atlas(surface, sizes, margin)
    assert (atlas.charts, atlas.overlapped) == (9, 0)
    near = np.zeros(atlas.kind.shape, int)
    boxes = 0
    for chart in range(9):
        owned = np.zeros(atlas.kind.shape, bool)
        owned.reshape(-1)[atlas.owned_cells[atlas.chart_of == chart]] = True
        near += maximum_filter(owned, 2 * margin + 1)
        rows, columns = np.nonzero(owned)
        boxes += (np.ptp(rows) + 1 + 2 * margin) * (np.ptp(columns) + 1 + 2 * margin)
    assert near.max() == 1
    assert atlas.kind.size < 0.6 * boxes
    # Nothing but the charts is there, and edges stay inside each.
    assert np.count_nonzero(atlas.kind != EMPTY) == atlas.covered
    labels = np.zeros(atlas.kind.size, int)
    labels[atlas.owned_cells] = 1 + atlas.chart_of
    labels = labels.reshape(atlas.kind.shape)
    for lengths, (down, right) in zip(atlas.squared_lengths, [(0, 1), (1, 0), (1, 1), (1, -1)], strict=True):
        row, column = np.nonzero(np.isfinite(lengths))
        assert np.array_equal(labels[row, column], labels[row + down, column + right])


def test_texels_keep_their_neighbours_however_charts_are_packed():
    """The same chart alone, and among others that lie in its hollows."""
    surface, sizes = stairs(9)
    together = build_atlas(surface, sizes, 3)
    first = surface.positions[surface.faces[:, 0], 2] == 0
    alone = build_atlas(
        textured(surface.positions, surface.faces[first], surface.uv[first] * sizes, sizes), sizes, 3
    )
    place = {}
    for atlas in (together, alone):
        mine = atlas.chart_of == 0
        order = np.argsort(atlas.owned_texels[mine])
        cells, texels = atlas.owned_cells[mine][order], atlas.owned_texels[mine][order]
        lengths = atlas.squared_lengths.reshape(4, -1)[:, cells]
        place[atlas.charts] = texels, lengths, np.divmod(cells, atlas.kind.shape[1])
    (texels, lengths, cells), (other_texels, other_lengths, other_cells) = place[9], place[1]
    assert np.array_equal(texels, other_texels)
    assert np.array_equal(lengths, other_lengths)
    assert all(np.ptp(here - there) == 0 for here, there in zip(cells, other_cells, strict=True))


@pytest.mark.parametrize("margin", [3, 4])
def test_even_texels_lie_at_even_cells(margin):
    """JPEG stores hues of squares of 2 x 2 texels: noise is measured in squares that never straddle them."""
    surface, sizes = cube(15), [(124, 24)]
    image = grid_atlas((7, 9), margin, None, np.ones((7, 9), bool))
    for atlas, (width, _) in ((build_atlas(surface, sizes, margin), sizes[0]), (image, (9, 7))):
        texels, cells = (
            np.array(np.divmod(places, columns))
            for places, columns in ((atlas.owned_texels, width), (atlas.owned_cells, atlas.kind.shape[1]))
        )
        assert len(np.unique(texels % 2, axis=1).T) == 4
        assert np.array_equal(texels % 2, cells % 2)
