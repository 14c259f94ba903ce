"""A plane cut in charts whose texels align is the uncut plane, exactly; where it is slit, nothing leads across."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import maximum_filter

from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, build_atlas
from oracles.textured import CutPlane, assert_equal, assert_sound, quads, shown_texels, slit, textured

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
    assert np.array_equal(np.sort(atlas.halo.weights, axis=1)[:, :3], np.zeros((len(atlas.halo.cells), 3)))
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
    assert_equal(atlas, build_atlas(plane.surface, plane.sizes, margin, 4))
    assert_sound(atlas, margin)
    assert (atlas.kind.reshape(-1)[atlas.gutter.cells] == HALO).all()
    assert not np.isin(atlas.gutter.texels, atlas.owned_texels).any()
    assert len(np.unique(atlas.gutter.texels)) == len(atlas.gutter.texels)


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
    shown = (place[atlas.halo.taps] * atlas.halo.weights[..., None]).sum(axis=1)
    first = np.flatnonzero(atlas.chart_of == 0)[0]
    wanted = places_on_grid(atlas, place, atlas.owned_cells[first])
    of_first = np.isin(atlas.halo.taps[:, 0], atlas.owned_cells[atlas.chart_of == 1])
    whole = of_first & ((atlas.halo.weights > 0).sum(axis=1) == 4)
    assert of_first.sum() == 16 * MARGIN
    assert np.allclose(shown[whole], wanted[whole], atol=1e-4)
    # Where texels around the place are missing at the border, the colour is off by less than two of them.
    assert np.abs(shown[of_first] - wanted[of_first]).max() < 2 / scale


def places_on_grid(atlas, place, owned):
    """Return the places of halo cells on the grid of the plane, on which a chart lies, counted from an owned cell."""
    columns = atlas.kind.shape[1]
    down, right = atlas.halo.cells // columns - owned // columns, atlas.halo.cells % columns - owned % columns
    return place[owned] + np.stack([right, down], axis=1)


def place_of_cell(atlas, place_of):
    """The place on the plane that each cell shows, not a number where it is empty."""
    place = np.full((atlas.kind.size, 2), np.nan)
    place[atlas.owned_cells] = place_of.reshape(-1, 2)[atlas.owned_texels]
    taps = np.take_along_axis(atlas.halo.taps, atlas.halo.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    place[atlas.halo.cells] = place[taps]
    return place.reshape(*atlas.kind.shape, 2)


def neighbours(atlas):
    """Pairs of neighbouring cells of one chart, neither empty: their indices, and whether they are joined."""
    rows, columns = atlas.kind.shape
    chart = np.full(atlas.kind.size, -1, np.int32)
    chart[atlas.owned_cells] = atlas.chart_of
    # The chart whose margin a cell is in.
    chart = maximum_filter(chart.reshape(atlas.kind.shape), 2 * MARGIN + 1)
    for lengths, (down, right) in zip(atlas.squared_lengths, STEPS, strict=True):
        row, column = np.mgrid[: rows - down, max(0, -right) : columns - max(0, right)].reshape(2, -1)
        both = (atlas.kind[row, column] != EMPTY) & (atlas.kind[row + down, column + right] != EMPTY)
        both &= chart[row, column] == chart[row + down, column + right]
        row, column = row[both], column[both]
        yield (row, column), (row + down, column + right), np.isfinite(lengths[row, column])


def crosses(one, other, start, end):
    """Whether lines between places go through a slit, and whether they go through one of its ends."""
    along = end - start
    sides = [(places + 0.5 - start) @ [-along[1], along[0]] for places in (one, other)]
    across = other - one
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = one + 0.5 + (sides[0] / (sides[0] - sides[1]))[:, None] * across
        share = (crossing - start) @ along / (along @ along)
    opposite = sides[0] * sides[1] < 0
    at_end = opposite & ((np.abs(share) < 1e-6) | (np.abs(share - 1) < 1e-6))
    return opposite & (share > 0) & (share < 1) & ~at_end, at_end


@st.composite
def slit_planes(draw):
    rows, columns, count = draw(st.integers(2, 5)), draw(st.integers(2, 5)), draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    side = draw(st.sampled_from((2, 4, 7)))
    flips = random.integers(0, 2, (rows, columns))
    labels = random.integers(0, count, (rows, columns))
    upright = draw(st.booleans())
    across = draw(st.integers(1, (columns if upright else rows) - 1))
    first, last = sorted(
        draw(st.lists(st.integers(0, rows if upright else columns), min_size=2, max_size=2, unique=True))
    )
    ends = [(across, first), (across, last)] if upright else [(first, across), (last, across)]
    plane = CutPlane(labels, flips, random.integers(0, 8, count), random.permutation(count), side)
    start, end = (side * np.array(point, float) for point in ends)
    through = (first == 0, last == (rows if upright else columns))
    assume(last - first > 1 or any(through))  # one edge whose ends are both joined is no slit
    plane.surface = slit(plane.surface, start, end, through)
    # A slit that goes through a border has no end there.
    outwards = (end - start) / np.linalg.norm(end - start)
    return plane, start - through[0] * outwards, end + through[1] * outwards


@pytest.mark.slow
@given(slit_planes())
@settings(max_examples=200, deadline=None)
def test_cells_are_joined_unless_a_slit_lies_between_them(made):
    """In one chart, over its seams, in its halo, and where a seam itself is slit."""
    plane, start, end = made
    atlas = build_atlas(plane.surface, plane.sizes, MARGIN, 2)
    place = place_of_cell(atlas, plane.place_of)
    cut = set()
    for one, other, joined in neighbours(atlas):
        through, at_end = crosses(place[one], place[other], start, end)
        assert np.array_equal(joined[~at_end], ~through[~at_end])
        for cells in (one, other):
            cut |= {*np.ravel_multi_index(np.array(cells)[:, ~joined], atlas.kind.shape).tolist()}
    assert cut == set(atlas.cut_cells.tolist())


@pytest.mark.parametrize("angle", [0.1, 0.9, 2.5])
def test_colours_beyond_a_seam_come_from_this_side_of_a_slit(angle):
    """Two halves side by side; in the image the second is turned, so that colours are interpolated in it."""
    positions, faces = quads(8, 4, 4, np.zeros((4, 8)))
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    second = positions[faces][..., 0].mean(axis=1) > 16
    corners = positions[faces][..., :2] + 4
    corners[second] = (positions[faces[second]][..., :2] - [24, 8]) @ matrix.T + [64, 24]
    start, end = np.array([8.0, 8.0]), np.array([28.0, 8.0])
    whole = textured(positions, faces, corners, [(96, 48)])
    atlas = build_atlas(slit(whole, start, end), [(96, 48)], MARGIN)
    centres = np.stack(np.divmod(atlas.owned_texels, 96)[::-1], axis=1) + 0.5
    turned = (centres - [64, 24]) @ matrix + [24, 8]
    place = np.full((atlas.kind.size, 2), np.nan)
    place[atlas.owned_cells] = np.where((centres[:, :1] < 24), centres - 4, turned)
    first = atlas.owned_cells[centres[:, 0] < 24][0]
    wanted = places_on_grid(atlas, place, first)
    of_first = (place[atlas.halo.taps[:, 0], 0] > 15.9) & (np.abs(wanted - [16, 8]).max(axis=1) < 8)
    assert np.count_nonzero(of_first) > 30
    mixed = np.zeros(len(wanted), bool)
    for tap, weight in zip(atlas.halo.taps.T, atlas.halo.weights.T, strict=True):
        mixed |= (weight > 0) & ((place[tap, 1] > 8) != (wanted[:, 1] > 8))
    assert not mixed[of_first].any()


def test_parts_of_a_chart_that_only_touch_in_the_image_are_not_joined():
    """A strip bent to a U whose arms lie side by side; sheets in other charts are sewn to their edges."""
    corners, faces = [], []
    positions = []
    for x, y in [(0, 0), (0, 1), (1, 1), (1, 0)]:  # squares of the strip, in the image
        square = np.array([[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]], float)
        place = np.column_stack([square, np.zeros(4)])
        if (x, y) == (1, 0):
            place[[0, 3], 0] += [0.5, 0]  # the arms spread: of their edge they share the lower end only
        positions.append(8 * place)
        corners.append(8 * square + 4)
    for x in (8.0, 12.0):  # sheets upright on the arms' inner edges
        positions.append(np.array([[x, 0, 0], [8, 8, 0], [8, 8, 8], [x, 0, 8]]))
        corners.append(np.array([[0, 0], [8, 0], [8, 8], [0, 8]]) + np.array([12 + 2.5 * x, 4]))
    for i in range(len(positions)):
        faces += [[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]]
    corners = np.concatenate([[square[[0, 1, 2]], square[[0, 2, 3]]] for square in corners])
    atlas = build_atlas(textured(np.concatenate(positions), faces, corners, [(64, 24)]), [(64, 24)], MARGIN)
    assert (atlas.charts, atlas.seams) == (3, 3)
    row, column = np.full((2, atlas.kind.size), -1)
    row[atlas.owned_cells], column[atlas.owned_cells] = np.divmod(atlas.owned_texels, 64)
    row[atlas.owned_cells[atlas.chart_of > 0]] = 99
    row, column = row.reshape(atlas.kind.shape) - 4, column.reshape(atlas.kind.shape) - 4
    is_inside = (atlas.kind == OWNED) & (row < 16)
    for one, other, joined in neighbours(atlas):
        inside = is_inside[one] & is_inside[other]
        between = (np.sort([column[one], column[other]], axis=0).T == [7, 8]).all(axis=1)
        apart = between & (row[one] + row[other] < 15)
        assert np.array_equal(joined[inside], ~apart[inside])


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 0.8, 0.95]))
@settings(max_examples=60, deadline=None)
def test_holes_of_a_depth_map_part_the_texels_at_its_vertices_only_where_they_lie(seed, share):
    """A vertex at each texel's centre: every line between texels runs along edges or through one square."""
    random = np.random.default_rng(seed)
    present = random.random((7, 9)) < share
    corners = sliding_window_view(present, (2, 2), writeable=True)

    def pinched():
        return (corners == corners[..., ::-1, ::-1]).all(axis=(2, 3)) & (corners.sum(axis=(2, 3)) == 2)

    while pinched().any():
        corners[pinched()] = True  # no squares meet at a corner only
    positions, faces = quads(9, 7, 1, random.integers(0, 2, (7, 9)))
    faces = faces.reshape(7, 9, 2, 3)[present].reshape(-1, 3)
    surface = textured(positions, faces, positions[faces][..., :2] + 2.5, [(16, 16)])
    atlas = build_atlas(surface, [(16, 16)], MARGIN)
    place = np.full((atlas.kind.size, 2), -9)
    place[atlas.owned_cells] = np.stack(np.divmod(atlas.owned_texels, 16), axis=1) - 2
    place = place.reshape(*atlas.kind.shape, 2)
    square = np.pad(present, 1)  # that of vertex (row, column) lies below and to its right
    for one, other, joined in neighbours(atlas):
        here, there = place[one], place[other]
        row, column = np.minimum(here, there).T + 1
        diagonal = (here != there).all(axis=1)
        upper, left = square[row - 1, column], square[row, column - 1]
        along = np.where(here[:, 0] == there[:, 0], upper, left) | square[row, column]
        assert np.array_equal(joined, np.where(diagonal, square[row, column], along))
