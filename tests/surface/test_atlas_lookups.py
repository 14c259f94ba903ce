"""Which texels that no face covers a renderer looks up, and which charts they belong to."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beltrami_cli.surface.atlas import build_atlas
from oracles.textured import strips, textured

SIZE = 32
SQUARE = np.array([[4, 4], [20, 4], [20, 20], [4, 20]], float)
PLACES = np.array([[0, 0, 0], [16, 0, 0], [16, 16, 0], [0, 16, 0]], float)
ABOVE = np.array([[0, 0, 50], [16, 0, 50], [16, 16, 50]], float)  # places of a face that touches no other


def with_face(places, corners):
    """Make a square of 16 texels, and a triangle next to it: its places, some of them the square's, and its corners."""
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    texels = np.concatenate([SQUARE[[0, 1, 2]], SQUARE[[0, 2, 3]], corners]).reshape(-1, 3, 2)
    positions = np.concatenate([PLACES, places])
    return build_atlas(textured(positions, faces, texels, [(SIZE, SIZE)]), [(SIZE, SIZE)], 3)


def ring(first, last):
    """Return the texels around a square of texels."""
    inside = np.zeros((SIZE, SIZE), bool)
    inside[first:last, first:last] = True
    around = np.zeros((SIZE, SIZE), bool)
    around[first - 1 : last + 1, first - 1 : last + 1] = True
    return np.flatnonzero(around & ~inside)


def test_a_chart_looks_up_the_texels_around_it():
    atlas = with_face(ABOVE, SQUARE[:3])
    assert atlas.border_texels.tolist() == ring(4, 20).tolist()
    assert not len(atlas.lone_texels)


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
    assert atlas.lone_texels.tolist() == sorted(row * SIZE + column for column, row in texels)


def test_what_a_face_without_texels_shows_is_not_the_gutter_of_the_chart_beside_it():
    """Two strips are joined by a seam, and the halo of the first reaches what a face elsewhere shows."""
    surface = strips([((0, 8), (4, 12)), ((8, 16), (20, 28))], (32, 16))
    alone = build_atlas(surface, [(32, 16)], 6)
    shown = [13 + 32 * 8, 14 + 32 * 8, 13 + 32 * 9, 14 + 32 * 9]
    assert np.isin(shown, alone.gutter_texels).all()
    positions = np.concatenate([surface.positions, [[0, 0, 50], [9, 0, 50], [0, 9, 50]]])
    faces = np.concatenate([surface.faces, [[8, 9, 10]]]).astype(np.int32)
    point = np.full((1, 3, 2), [14.1, 9.0]) / [32, 16]
    surface = dataclasses.replace(
        surface, positions=positions, faces=faces, uv=np.concatenate([surface.uv, point]),
        texture_of=np.zeros(len(faces), np.int32),
    )  # fmt: skip
    atlas = build_atlas(surface, [(32, 16)], 6)
    assert atlas.lone_texels.tolist() == sorted(shown)
    assert np.array_equal(np.setdiff1d(alone.gutter_texels, atlas.gutter_texels), sorted(shown))


def test_a_face_without_area_on_a_border_shows_the_chart():
    """Two of its corners are corners of the square, in the image, too, and the third lies between them there."""
    corners = np.array([[20, 4], [20, 20], [20, 12]], float)
    atlas = with_face(np.array([[16, 0, 0], [16, 16, 0], [24, 8, 0]]), corners)
    assert atlas.border_texels.tolist() == ring(4, 20).tolist()
    assert not len(atlas.lone_texels)
    elsewhere = with_face(np.array([[16, 0, 50], [16, 16, 50], [24, 8, 50]]), corners)
    assert len(elsewhere.lone_texels)


def test_mirrored_halves_look_up_what_their_owner_does():
    """The second chart owns no texel, but covers texels of the first."""
    mirrored = np.array([[-16, 0, 0], [0, 0, 0], [0, 16, 0]], float)
    corners = np.array([[20, 4], [4, 4], [4, 20]], float)
    atlas = with_face(mirrored, corners)
    assert atlas.charts == 2
    assert atlas.overlapped
    assert not len(atlas.lone_texels)
    assert np.isin(ring(4, 20), atlas.border_texels).all()


def test_the_gutter_of_an_open_border_is_not_the_halo_of_another_chart():
    """A seam joins two strips; next to it, in the image, lies a third one, which is joined to none."""
    surface = strips([((0, 8), (4, 12)), ((8, 16), (20, 28)), ((40, 48), (14, 18))], (32, 16))
    atlas = build_atlas(surface, [(32, 16)], 6)
    column, row = atlas.gutter_texels % 32, atlas.gutter_texels // 32
    beside_third = (row >= 4) & (row < 12) & ((column == 13) | (column == 18))
    assert len(column)
    assert not beside_third.any()
    # A texel away from all three, the nearest chart counts.
    assert ((column == 12) & (row == 8)).any()


def test_lookups_go_round_where_a_texture_repeats():
    corners = np.array([[30.0, 10.25], [34.0, 10.25], [32.0, 10.25]])
    atlas = with_face(ABOVE, corners)
    assert np.unique(atlas.lone_texels % SIZE).tolist() == [0, 1, 2, 29, 30, 31]
