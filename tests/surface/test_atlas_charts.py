"""Charts, seams, neighbours beyond seams, and how charts are packed."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, build_atlas
from beltrami_cli.surface.grid_atlas import grid_atlas
from beltrami_cli.surface.gutters import within
from oracles.textured import assert_equal, cube, quads, shown_texels, strips, textured

RIGHT = 0


def square(texels=16, place=(4, 4), image=32):
    """Two triangles over a square of the image."""
    positions, faces = quads(1, 1, texels, np.zeros((1, 1)))
    return textured(positions, faces, positions[faces][..., :2] + place, [(image, image)])


def test_a_cube_has_six_charts_and_twelve_seams():
    surface = cube(16)
    atlas = build_atlas(surface, [(124, 24)], 3)
    assert (atlas.charts, atlas.seams) == (6, 12)
    assert atlas.covered == 6 * 16 * 16
    assert np.bincount(atlas.chart_of).tolist() == [256] * 6
    assert len(atlas.halo.cells) == 6 * (22 * 22 - 16 * 16)  # closed: every cell of a margin has a place
    assert set(atlas.halo.seams) == set(range(12))


def test_a_halo_lies_on_the_surface_where_the_chart_goes_on():
    """Next to a cube's edge both cells are half a texel away from it, at a right angle."""
    atlas = build_atlas(cube(16), [(124, 24)], 3)
    lengths = atlas.squared_lengths[RIGHT]
    pair = (atlas.kind[:, :-1] == OWNED) & (atlas.kind[:, 1:] == HALO)
    assert pair.sum() == 6 * 16
    assert np.allclose(lengths[:, :-1][pair], 0.5, atol=1e-6)
    inside = (atlas.kind[:, :-1] == OWNED) & (atlas.kind[:, 1:] == OWNED)
    assert np.array_equal(lengths[:, :-1][inside], np.ones(inside.sum(), np.float32))


def test_faces_on_one_side_of_their_common_edge_in_the_image_are_mirrored_halves():
    positions = np.array([[0, 0, 0], [0, 8, 0], [8, 4, 0], [-8, 4, 0]], float)
    corners = [[[4, 4], [4, 12], [12, 8]], [[4, 12], [4, 4], [12, 8]]]
    surface = textured(positions, [[0, 1, 2], [1, 0, 3]], corners, [(16, 16)])
    atlas = build_atlas(surface, [(16, 16)], 3)
    assert (atlas.charts, atlas.seams) == (2, 1)
    assert atlas.overlapped == atlas.covered == len(atlas.owned_cells)
    assert set(atlas.chart_of) == {0}
    rows, columns = np.divmod(atlas.halo.cells, atlas.kind.shape[1])
    mirrored = atlas.halo.taps[:, 0]
    assert (atlas.halo.weights[:, 0] == 1).all()
    first = columns.max() + 1  # the column of owned cells at the axis
    assert np.array_equal(mirrored, rows * atlas.kind.shape[1] + 2 * first - 1 - columns)


def test_a_texture_that_tiles_needs_one_period_only_and_wraps():
    periods, size = 30, 16
    positions, faces = quads(periods, periods, 1, np.zeros((periods, periods)))
    corners = positions[faces][..., :2] * size + 5
    surface = textured(positions, faces, corners, [(size, size)])
    atlas = build_atlas(surface, [(size, size)], 3)
    assert (atlas.charts, atlas.covered, atlas.overlapped) == (1, size * size, size * size)
    assert atlas.kind.shape == (size + 6, size + 6)
    assert (atlas.halo.seams == -1).all()
    columns = shown_texels(atlas)[8] % size
    assert np.array_equal(np.diff(columns) % size, np.ones(size + 5))
    finite = atlas.squared_lengths[RIGHT][np.isfinite(atlas.squared_lengths[RIGHT])]
    assert np.allclose(finite, size**-2)


@pytest.mark.parametrize(("wrap", "covered"), [("repeat", 48), ("mirror", 24), ("clamp", 24)])
def test_what_lies_beyond_the_image_follows_the_wrap_mode(wrap, covered):
    """A square that lies half over the image's right border, 3 texels."""
    positions, faces = quads(1, 1, 8, np.zeros((1, 1)))
    corners = positions[faces][..., :2] * [0.75, 1] + [13, 4]
    atlas = build_atlas(textured(positions, faces, corners, [(16, 16)], wrap=(wrap, "repeat")), [(16, 16)], 3)
    assert atlas.covered == covered
    assert atlas.overlapped == (24 if wrap == "mirror" else 0)


def test_two_textures_are_joined_by_seams():
    positions, faces = quads(2, 1, 8, np.zeros((1, 2)))
    corners = positions[faces][..., :2] + 4
    surface = textured(positions, faces, corners, [(24, 16), (32, 40)], texture_of=[0, 0, 1, 1])
    atlas = build_atlas(surface, [(24, 16), (32, 40)], 3)
    assert (atlas.charts, atlas.seams) == (2, 1)
    assert atlas.texture_offsets.tolist() == [0, 24 * 16, 24 * 16 + 32 * 40]
    assert np.bincount(atlas.owned_texels >= 24 * 16).tolist() == [64, 64]
    assert len(atlas.halo.cells) == 2 * 8 * 3


def test_three_faces_on_an_edge_end_the_chart():
    positions = np.array([[0, 0, 0], [0, 8, 0], [8, 4, 0], [-8, 4, 0], [0, 4, 8]], float)
    triangle = np.array([[0, 0], [0, 8], [8, 4]])
    corners = triangle + np.array([[[4, 4]], [[20, 4]], [[36, 4]]])
    surface = textured(positions, [[0, 1, 2], [0, 1, 3], [0, 1, 4]], corners, [(64, 16)])
    atlas = build_atlas(surface, [(64, 16)], 3)
    assert (atlas.charts, atlas.seams, len(atlas.halo.cells)) == (3, 0, 0)


def test_faces_given_twice_count_once():
    surface = square()
    twice = dataclasses.replace(
        surface,
        faces=np.concatenate([surface.faces, surface.faces[:, ::-1]]),
        uv=np.concatenate([surface.uv, surface.uv[:, ::-1]]),
        texture_of=np.zeros(4, np.int32),
    )
    assert_equal(build_atlas(surface, [(32, 32)], 3), build_atlas(twice, [(32, 32)], 3))


def test_vertices_are_joined_in_one_space_only():
    surface = cube(8)
    apart = np.repeat(np.arange(6, dtype=np.int32), 4)
    atlas = build_atlas(dataclasses.replace(surface, space_of=apart), [(124, 24)], 3)
    assert (atlas.charts, atlas.seams) == (6, 0)


def test_the_walk_leads_over_charts_without_texels():
    """A strip thinner than a texel, in a chart of its own, lies between two squares."""
    spans = [((0, 8), (4, 12)), ((8, 8.125), (18.6, 18.725)), ((8.125, 16.125), (30, 38))]
    atlas = build_atlas(strips(spans, (48, 16)), [(48, 16)], 3)
    assert (atlas.charts, atlas.seams) == (3, 2)
    assert set(atlas.chart_of) == {0, 2}
    assert len(atlas.halo.cells) == 2 * 8 * 3
    # The strip shifts what lies beyond it by an eighth of a texel; the first texel beyond has no texel before it.
    weights = np.sort(atlas.halo.weights, axis=1)[:, 2:]
    alone = weights[:, 1] == 1
    assert alone.sum() == 2 * 8
    assert np.allclose(weights[~alone], [0.125, 0.875], atol=1e-6)


def test_texel_centres_on_the_border_are_covered():
    """A grid with a vertex at each texel's centre, as depth maps give, covers all texels."""
    positions, faces = quads(7, 5, 1, np.zeros((5, 7)))
    surface = textured(positions, faces, positions[faces][..., :2] + 0.5, [(8, 6)])
    atlas = build_atlas(surface, [(8, 6)], 3)
    assert (atlas.covered, atlas.overlapped) == (48, 0)
    assert np.array_equal(atlas.squared_lengths[RIGHT][4:10, 4:11], np.ones((6, 7), np.float32))


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


@pytest.mark.parametrize("reach", [0, 1, 2, 5, 13, 40])
def test_cells_are_near_up_to_the_edges_of_the_canvas(reach):
    covered = np.random.default_rng(reach).random((60, 45)) < 0.005
    covered[[0, 11, 23, 23], [0, 17, 3, 39]] = True
    assert np.array_equal(within(covered, reach), maximum_filter(covered, 2 * reach + 1, mode="constant"))
