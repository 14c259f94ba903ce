"""The halo where faces are thin in the image, or have no area there at all."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.surface.atlas import build_atlas
from oracles.textured import textured

MARGIN, HEIGHT = 3, 8


def bands(spans):
    """A plane cut in upright bands, each from x to x in space and from u to u in the image, in texels."""
    positions, faces, corners = [], [], []
    for (left, right), (first, last) in spans:
        positions += [[left, 0, 0], [right, 0, 0], [right, HEIGHT, 0], [left, HEIGHT, 0]]
        quad = np.array([[first, 4], [last, 4], [last, 4 + HEIGHT], [first, 4 + HEIGHT]], float)
        start = len(positions) - 4
        faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
        corners += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    return textured(positions, faces, corners, [(64, 16)])


def lengths_to_the_right(atlas):
    """Along a row of the first band, from its first texel."""
    first = atlas.owned_cells[atlas.chart_of == 0][0] + 3 * atlas.kind.shape[1]
    return np.sqrt(atlas.squared_lengths[0].reshape(-1)[first : first + 12 + MARGIN - 1])


def shown(atlas, place_of_column):
    """For each halo cell: its column in the image as the first band goes on, its x in space by its taps."""
    columns = atlas.kind.shape[1]
    column = np.full(atlas.kind.size, np.nan)
    column[atlas.owned_cells] = atlas.owned_texels % 64
    first = atlas.owned_cells[column[atlas.owned_cells] < 20]
    origin = first[0] % columns - column[first[0]]
    box = atlas.halo_cells % columns - origin, atlas.halo_cells // columns
    rows = np.unique(first // columns)
    mine = (
        np.isin(box[1], rows) & (box[0] > column[first].max()) & (box[0] < column[first].max() + MARGIN + 1)
    )
    x = place_of_column(column[atlas.halo_taps])
    return box[0][mine] + 0.5, (x * atlas.halo_weights).sum(axis=1)[mine]


def test_a_sliver_at_the_border_does_not_throw_the_halo_far_away():
    """The last fifth of a texel holds three texels' width of the surface; beyond it texels are as before."""
    atlas = build_atlas(
        bands([((0, 13), (0, 13)), ((13, 16), (13, 13.2)), ((16, 40), (20, 44))]), [(64, 16)], MARGIN
    )
    assert (atlas.charts, atlas.seams) == (2, 1)
    u, x = shown(atlas, lambda column: column + 0.5 - 4)
    assert len(u) == MARGIN * HEIGHT
    # What lies beyond the border is as far from it as in texels, and not fifteen times that; the first column lies
    # before the other chart's first texels, whose colour it has.
    assert np.allclose(x, np.maximum(16 + (u - 13.2), 16.5), atol=1e-4)
    assert np.allclose(lengths_to_the_right(atlas)[12:], [3.8, 1], atol=1e-5)


@pytest.mark.parametrize("width", [1.0, 2.0])
def test_a_strip_without_area_in_the_image_shows_the_texels_that_it_is_painted_with(width):
    """All of the strip is painted with column 30 of the other chart, which lies far from it on the surface."""
    spans = [((0, 12), (0, 12)), ((12, 12 + width), (30.5, 30.5)), ((12 + width, 40), (20, 48 - width))]
    atlas = build_atlas(bands(spans), [(64, 16)], MARGIN)
    u, x = shown(atlas, lambda column: column)
    assert len(u) == MARGIN * HEIGHT  # no gap
    over = u < 12 + width
    assert np.allclose(x[over], 30)
    assert np.allclose(x[~over], 20 + u[~over] - 12 - width - 0.5, atol=1e-4)


def test_over_a_chart_too_small_for_texels_colours_come_from_beyond_it():
    """A strip that is three texels wide on the surface, but less than half of one in the image."""
    spans = [((0, 12), (0, 12)), ((12, 15), (55.05, 55.45)), ((15, 40), (20, 45))]
    atlas = build_atlas(bands(spans), [(64, 16)], MARGIN)
    assert (atlas.charts, set(atlas.chart_of)) == (3, {0, 2})
    assert np.allclose(lengths_to_the_right(atlas), 1, atol=1e-5)  # no gap, and each at its own place
