"""A plane cut in charts whose texels align is the uncut plane, exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.surface.atlas import EMPTY, HALO, build_atlas
from oracles.textured import CutPlane, assert_sound, quads, shown_texels, textured

MARGIN = 3
STEPS = [(0, 1), (1, 0), (1, 1), (1, -1)]  # (down, right) of the planes of squared lengths


@st.composite
def cut_planes(draw):
    rows, columns, count = draw(st.integers(1, 4)), draw(st.integers(1, 5)), draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    labels = random.integers(0, count, (rows, columns))
    flips = random.integers(0, 2, (rows, columns))
    side = draw(st.sampled_from((2, 4, 8)))
    return CutPlane(labels, flips, random.integers(0, 8, count), random.permutation(count), side)


@pytest.mark.slow
@given(cut_planes())
@settings(max_examples=150, deadline=None)
def test_around_every_texel_is_the_plane(plane):
    atlas = build_atlas(plane.surface, plane.sizes, MARGIN, 2)
    assert atlas.covered == plane.width * plane.height
    assert atlas.overlapped == 0
    assert np.array_equal(np.sort(atlas.halo_weights, axis=1)[:, :3], np.zeros((len(atlas.halo_cells), 3)))
    texel = shown_texels(atlas)
    places = plane.place_of.reshape(-1, 2)
    turns = plane.turn.reshape(-1, 2, 2)[atlas.owned_texels]
    rows, columns = np.divmod(atlas.owned_cells, atlas.kind.shape[1])
    here = places[atlas.owned_texels]
    for down in range(-MARGIN, MARGIN + 1):
        for right in range(-MARGIN, MARGIN + 1):
            wanted = here + turns @ np.array([right, down])
            on_plane = ((wanted >= 0) & (wanted < [plane.width, plane.height])).all(axis=1)
            found = texel[rows + down, columns + right]
            assert np.array_equal(found >= 0, on_plane)
            assert np.array_equal(places[found[on_plane]], wanted[on_plane])


@given(cut_planes())
@settings(max_examples=60, deadline=None)
def test_lengths_are_those_of_the_plane(plane):
    atlas = build_atlas(plane.surface, plane.sizes, MARGIN, 1)
    rows, columns = np.divmod(atlas.owned_cells, atlas.kind.shape[1])
    for lengths, (down, right) in zip(atlas.squared_lengths, STEPS, strict=True):
        assert np.all(lengths[np.isfinite(lengths)] == down * down + right * right)
        for row, column in ((rows, columns), (rows - down, columns - right)):  # from and to owned cells
            both = (atlas.kind[row, column] != EMPTY) & (atlas.kind[row + down, column + right] != EMPTY)
            assert np.array_equal(np.isfinite(lengths[row, column]), both)


@given(cut_planes(), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_the_result_does_not_depend_on_threads_and_lists_are_sound(plane, margin):
    atlas = build_atlas(plane.surface, plane.sizes, margin, 1)
    again = build_atlas(plane.surface, plane.sizes, margin, 4)
    for name in vars(atlas).keys() - {"lengths"} | {"squared_lengths"}:
        assert np.array_equal(getattr(atlas, name), getattr(again, name)), name
    assert_sound(atlas, margin)
    assert (atlas.kind.reshape(-1)[atlas.gutter_cells] == HALO).all()
    assert not np.isin(atlas.gutter_texels, atlas.owned_texels).any()
    assert len(np.unique(atlas.gutter_texels)) == len(atlas.gutter_texels)


@given(st.floats(0, 2 * np.pi), st.floats(0.6, 1.8), st.booleans())
@settings(max_examples=60, deadline=None)
def test_beyond_a_seam_texels_are_interpolated_where_the_plane_goes_on(angle, scale, mirrored):
    """Two squares side by side; in the image the second is turned, scaled, perhaps mirrored."""
    positions, faces = quads(2, 1, 16, np.array([[0, 1]]))
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = matrix @ np.diag([1, -1 if mirrored else 1])
    shift = np.array([96.0, 48.0])
    corners = positions[faces][..., :2] + 4
    corners[2:] = (positions[faces[2:]][..., :2] - [24, 8]) @ matrix.T + shift
    size = (160, 96)
    atlas = build_atlas(textured(positions, faces, corners, [size]), [size], MARGIN)
    centres = np.stack(np.divmod(atlas.owned_texels, size[0])[::-1], axis=1) + 0.5
    turned = (centres - shift) @ np.linalg.inv(matrix).T + [24, 8]
    place = np.full((atlas.kind.size, 2), np.nan)
    place[atlas.owned_cells] = np.where(atlas.chart_of[:, None] == 0, centres - 4, turned)
    shown = (place[atlas.halo_taps] * atlas.halo_weights[..., None]).sum(axis=1)
    # The cells of the first chart lie on the grid of the plane: count them from an owned cell.
    first = np.flatnonzero(atlas.chart_of == 0)[0]
    origin = (
        np.array(np.divmod(atlas.owned_cells[first], atlas.kind.shape[1])[::-1])
        - place[atlas.owned_cells[first]]
    )
    wanted = np.stack(np.divmod(atlas.halo_cells, atlas.kind.shape[1])[::-1], axis=1) - origin
    of_first = np.isin(atlas.halo_taps[:, 0], atlas.owned_cells[atlas.chart_of == 1])
    whole = of_first & ((atlas.halo_weights > 0).sum(axis=1) == 4)
    assert of_first.sum() == 16 * MARGIN
    assert np.allclose(shown[whole], wanted[whole], atol=1e-4)
    # Where texels around the place are missing at the border, the colour is off by less than two of them.
    assert np.abs(shown[of_first] - wanted[of_first]).max() < 2 / scale
