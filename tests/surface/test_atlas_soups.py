"""Any triangles with any texture coordinates make a sound atlas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, build_atlas
from oracles.textured import textured

coordinates = st.one_of(
    st.integers(-64, 64).map(lambda i: i / 2),
    st.floats(-1, 33),
    st.floats(-1e12, 1e12),
    st.sampled_from((0.0, 1e-9, 8.0, np.inf, -np.inf, np.nan)),
)


@st.composite
def soups(draw):
    places, count = draw(st.integers(1, 8)), draw(st.integers(0, 12))
    positions = draw(
        st.lists(st.tuples(*[st.sampled_from((0.0, 1.0, 2.0, 1e-12))] * 3), min_size=places, max_size=places)
    )
    faces = draw(st.lists(st.tuples(*[st.integers(0, places - 1)] * 3), min_size=count, max_size=count))
    corners = draw(st.lists(coordinates, min_size=6 * count, max_size=6 * count))
    sizes = draw(st.lists(st.tuples(st.integers(1, 24), st.integers(1, 24)), min_size=1, max_size=2))
    texture_of = draw(st.lists(st.integers(-1, len(sizes) - 1), min_size=count, max_size=count))
    wrap = draw(st.tuples(*[st.sampled_from(("repeat", "mirror", "clamp"))] * 2))
    return textured(positions, faces, corners, sizes, texture_of, wrap), sizes


@given(soups(), st.integers(1, 7))
@settings(max_examples=120, deadline=None)
def test_every_covered_texel_is_owned_once_and_halos_draw_on_owned_cells(soup, margin):
    surface, sizes = soup
    atlas = build_atlas(surface, sizes, margin)
    flat = atlas.kind.reshape(-1)
    assert np.array_equal(np.flatnonzero(flat == OWNED), atlas.owned_cells)
    assert np.array_equal(np.flatnonzero(flat == HALO), atlas.halo_cells)
    assert len(np.unique(atlas.owned_texels)) == len(atlas.owned_texels) == atlas.covered >= atlas.overlapped
    assert (flat[atlas.halo_taps] == OWNED).all()
    assert (atlas.halo_weights >= 0).all()
    assert np.allclose(atlas.halo_weights.sum(axis=1), 1, atol=1e-6)
    assert np.isin(atlas.halo_seams, np.arange(-1, atlas.seams)).all()
    lengths = atlas.squared_lengths
    assert (lengths >= 0).all()
    assert np.isinf(lengths[:, atlas.kind == EMPTY]).all()
    outer = np.ones_like(atlas.kind, bool)
    outer[margin:-margin, margin:-margin] = False
    assert not (atlas.kind[outer] == OWNED).any()


@pytest.mark.parametrize(("slivers", "halo"), [(20, 2 * 8 * 3), (200, 0)])
def test_slivers_at_a_seam_are_crossed_up_to_a_bound(slivers, halo):
    """Two squares with thin strips between them, a quarter of a texel together, each a chart of its own."""
    x = np.concatenate([[0.0], 8 + np.linspace(0, 0.25, slivers + 1), [16.25]])
    positions = np.concatenate(
        [np.column_stack([x, np.full(len(x), y), np.zeros(len(x))]) for y in (0.0, 8.0)]
    )
    faces, corners = [], []
    for i in range(len(x) - 1):
        faces += [[i, i + 1, i + 1 + len(x)], [i, i + 1 + len(x), i + len(x)]]
        # Strips stand where no texel has its centre.
        left = 4 if i == 0 else 24 if i == len(x) - 2 else 16.6
        right = left + x[i + 1] - x[i]
        quad = np.array([[left, 4], [right, 4], [right, 12], [left, 12]])
        corners += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    atlas = build_atlas(textured(positions, faces, corners, [(40, 16)]), [(40, 16)], 3)
    assert atlas.covered == 2 * 64
    assert len(atlas.halo_cells) == halo
