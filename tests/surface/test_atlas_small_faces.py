"""Faces that are thin, or without texels, in the image: halos beyond them, and the texels that a renderer looks up."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.surface.atlas import EMPTY, OWNED, build_atlas
from oracles.textured import assert_sound, strips, textured

MARGIN, HEIGHT, SIZE = 3, 8, (64, 16)


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
    box = atlas.halo.cells % columns - origin, atlas.halo.cells // columns
    rows = np.unique(first // columns)
    beyond = box[0] - column[first].max()
    mine = np.isin(box[1], rows) & (beyond > 0) & (beyond < MARGIN + 1)
    x = place_of_column(column[atlas.halo.taps])
    return box[0][mine] + 0.5, (x * atlas.halo.weights).sum(axis=1)[mine]


def test_a_sliver_at_the_border_does_not_throw_the_halo_far_away():
    """The last fifth of a texel holds three texels' width of the surface; beyond it texels are as before."""
    spans = [((0, 13), (0, 13)), ((13, 16), (13, 13.2)), ((16, 40), (20, 44))]
    atlas = build_atlas(strips(spans, SIZE), [SIZE], MARGIN)
    assert (atlas.charts, atlas.seams) == (2, 1)
    u, x = shown(atlas, lambda column: column + 0.5 - 4)
    assert len(u) == MARGIN * HEIGHT
    # What lies beyond the border is as far from it as in texels, and not fifteen times that; the first column lies
    # before the other chart's first texels, whose colour it has.
    assert np.allclose(x, np.maximum(16 + (u - 13.2), 16.5), atol=1e-4)
    assert np.allclose(lengths_to_the_right(atlas)[12:], [3.8, 1], atol=1e-5)


@pytest.mark.parametrize("width", [1.0, 2.0])
def test_a_strip_without_area_in_the_image_shows_the_texels_that_it_shows(width):
    """All of the strip shows column 30 of the other chart, which lies far from it on the surface."""
    spans = [((0, 12), (0, 12)), ((12, 12 + width), (30.5, 30.5)), ((12 + width, 40), (20, 48 - width))]
    atlas = build_atlas(strips(spans, SIZE), [SIZE], MARGIN)
    u, x = shown(atlas, lambda column: column)
    assert len(u) == MARGIN * HEIGHT  # no gap
    over = u < 12 + width
    assert np.allclose(x[over], 30)
    assert np.allclose(x[~over], 20 + u[~over] - 12 - width - 0.5, atol=1e-4)


@pytest.mark.parametrize(("slivers", "halo"), [(20, 2 * 8 * 3), (200, 0)])
def test_slivers_at_a_seam_are_crossed_up_to_a_bound(slivers, halo):
    """Two squares with thin strips between them, a quarter of a texel together, each a chart of its own."""
    x = np.concatenate([[0.0], 8 + np.linspace(0, 0.25, slivers + 1), [16.25]])
    # Strips stand where no texel has its centre.
    first = np.array([4, *[16.6] * slivers, 24])
    spans = zip(pairwise(x), zip(first, first + np.diff(x), strict=True), strict=True)
    atlas = build_atlas(strips(spans, (40, 16)), [(40, 16)], 3)
    assert atlas.covered == 2 * 64
    assert len(atlas.halo.cells) == halo


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


@pytest.mark.slow
@given(soups(), st.integers(1, 7))
@settings(max_examples=120, deadline=None)
def test_every_covered_texel_is_owned_once_and_halos_draw_on_owned_cells(soup, margin):
    surface, sizes = soup
    atlas = build_atlas(surface, sizes, margin)
    flat = atlas.kind.reshape(-1)
    assert_sound(atlas, margin)
    assert (flat[atlas.halo.taps] == OWNED).all()
    assert (atlas.halo.weights >= 0).all()
    assert np.allclose(atlas.halo.weights.sum(axis=1), 1, atol=1e-6)
    assert np.isin(atlas.halo.seams, np.arange(-1, atlas.seams)).all()
    lengths = atlas.squared_lengths
    assert (lengths >= 0).all()
    assert np.isinf(lengths[:, atlas.kind == EMPTY]).all()
    outer = np.ones_like(atlas.kind, bool)
    outer[margin:-margin, margin:-margin] = False
    assert not (atlas.kind[outer] == OWNED).any()
    # No face covers the texels that faces look up, each is listed once, and none is another chart's gutter.
    listed = np.concatenate([atlas.owned_texels, atlas.gutter.border_texels, atlas.gutter.lone_texels])
    assert len(np.unique(listed)) == len(listed)
    assert not np.isin(atlas.gutter.texels, atlas.gutter.lone_texels).any()


IMAGE_SIDE = 32
SQUARE = np.array([[4, 4], [20, 4], [20, 20], [4, 20]], float)
PLACES = np.array([[0, 0, 0], [16, 0, 0], [16, 16, 0], [0, 16, 0]], float)
ABOVE = np.array([[0, 0, 50], [16, 0, 50], [16, 16, 50]], float)  # places of a face that touches no other


def with_face(places, corners):
    """Make a square of 16 texels, and a triangle next to it: its places, some of them the square's, and its corners."""
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    texels = np.concatenate([SQUARE[[0, 1, 2]], SQUARE[[0, 2, 3]], corners]).reshape(-1, 3, 2)
    sizes = [(IMAGE_SIDE, IMAGE_SIDE)]
    return build_atlas(textured(np.concatenate([PLACES, places]), faces, texels, sizes), sizes, 3)


def ring(first, last):
    """Return the texels around a square of texels."""
    inside = np.zeros((IMAGE_SIDE, IMAGE_SIDE), bool)
    inside[first:last, first:last] = True
    around = np.zeros((IMAGE_SIDE, IMAGE_SIDE), bool)
    around[first - 1 : last + 1, first - 1 : last + 1] = True
    return np.flatnonzero(around & ~inside)


def test_a_chart_looks_up_the_texels_around_it():
    atlas = with_face(ABOVE, SQUARE[:3])
    assert atlas.gutter.border_texels.tolist() == ring(4, 20).tolist()
    assert not len(atlas.gutter.lone_texels)


@pytest.mark.parametrize(
    ("corners", "texels"),
    [
        (np.full((3, 2), [26.25, 10.75]), [(25, 10), (26, 10), (25, 11), (26, 11)]),
        (np.array([[26.6, 10.6], [26.9, 10.6], [26.9, 10.9]]), [(26, 10), (27, 10), (26, 11), (27, 11)]),
    ],
    ids=["a point", "between texel centres"],
)
def test_a_face_without_texels_looks_up_the_texels_around_it(corners, texels):
    atlas = with_face(ABOVE, corners)
    assert atlas.gutter.lone_texels.tolist() == sorted(row * IMAGE_SIDE + column for column, row in texels)


def test_what_a_face_without_texels_shows_is_not_the_gutter_of_the_chart_beside_it():
    """Two strips are joined by a seam, and the halo of the first reaches what a face elsewhere shows."""
    surface = strips([((0, 8), (4, 12)), ((8, 16), (20, 28))], (32, 16))
    alone = build_atlas(surface, [(32, 16)], 6)
    shown = [13 + 32 * 8, 14 + 32 * 8, 13 + 32 * 9, 14 + 32 * 9]
    assert np.isin(shown, alone.gutter.texels).all()
    positions = np.concatenate([surface.positions, [[0, 0, 50], [9, 0, 50], [0, 9, 50]]])
    faces = np.concatenate([surface.faces, [[8, 9, 10]]]).astype(np.int32)
    point = np.full((1, 3, 2), [14.1, 9.0]) / [32, 16]
    surface = dataclasses.replace(
        surface, positions=positions, faces=faces, uv=np.concatenate([surface.uv, point]),
        texture_of=np.zeros(len(faces), np.int32),
    )  # fmt: skip
    atlas = build_atlas(surface, [(32, 16)], 6)
    assert atlas.gutter.lone_texels.tolist() == sorted(shown)
    assert np.array_equal(np.setdiff1d(alone.gutter.texels, atlas.gutter.texels), sorted(shown))


def test_a_face_without_area_on_a_border_shows_the_chart():
    """Two of its corners are corners of the square, in the image, too, and the third lies between them there."""
    corners = np.array([[20, 4], [20, 20], [20, 12]], float)
    atlas = with_face(np.array([[16, 0, 0], [16, 16, 0], [24, 8, 0]]), corners)
    assert atlas.gutter.border_texels.tolist() == ring(4, 20).tolist()
    assert not len(atlas.gutter.lone_texels)
    elsewhere = with_face(np.array([[16, 0, 50], [16, 16, 50], [24, 8, 50]]), corners)
    assert len(elsewhere.gutter.lone_texels)


def test_mirrored_halves_look_up_what_their_owner_does():
    """The second chart owns no texel, but covers texels of the first."""
    mirrored = np.array([[-16, 0, 0], [0, 0, 0], [0, 16, 0]], float)
    corners = np.array([[20, 4], [4, 4], [4, 20]], float)
    atlas = with_face(mirrored, corners)
    assert atlas.charts == 2
    assert atlas.overlapped
    assert not len(atlas.gutter.lone_texels)
    assert np.isin(ring(4, 20), atlas.gutter.border_texels).all()


def test_the_gutter_of_an_open_border_is_not_the_halo_of_another_chart():
    """A seam joins two strips; next to it, in the image, lies a third one, which is joined to none."""
    surface = strips([((0, 8), (4, 12)), ((8, 16), (20, 28)), ((40, 48), (14, 18))], (32, 16))
    atlas = build_atlas(surface, [(32, 16)], 6)
    column, row = atlas.gutter.texels % 32, atlas.gutter.texels // 32
    beside_third = (row >= 4) & (row < 12) & ((column == 13) | (column == 18))
    assert len(column)
    assert not beside_third.any()
    # A texel away from all three, the nearest chart counts.
    assert ((column == 12) & (row == 8)).any()


def test_lookups_go_round_where_a_texture_repeats():
    corners = np.array([[30.0, 10.25], [34.0, 10.25], [32.0, 10.25]])
    atlas = with_face(ABOVE, corners)
    assert np.unique(atlas.gutter.lone_texels % IMAGE_SIDE).tolist() == [0, 1, 2, 29, 30, 31]
