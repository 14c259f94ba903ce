"""What a format splits is one sample, also if copies differ by rounding; hard colour edges keep both colours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import beltrami_cli
from beltrami_cli.surface import grouping
from beltrami_cli.surface.grouping import group_equal_rows, group_places
from beltrami_cli.surface.records import ColouredVertices
from beltrami_cli.surface.sampling import sample_vertices
from oracles import surfaces

SIDE = 12  # vertices


def sheet(offset=0.0, scale=1.0):
    """Vertices of a bent square of unit side, rounded to single precision, and its triangles."""
    places, faces = surfaces.plane(SIDE, SIDE, 1 / (SIDE - 1))
    places[:, 2] = 0.1 * np.sin(4 * places[:, 0])
    return (scale * places + offset).astype(np.float32), faces


def fallen_apart(places, faces, units=1):
    """Give each corner a vertex of its own, a random number of units in the last place off; and each one's number."""
    number = faces.ravel()
    step = np.spacing(np.abs(places).max())
    noise = np.random.default_rng(8).integers(-units, units + 1, (len(number), 3)).astype(np.float32)
    copies = np.float32(places[number] + step * noise / 2)
    return copies, np.arange(len(number), dtype=np.int32).reshape(-1, 3), number


def is_same_partition(one, other):
    pairs = len(np.unique(np.stack([one, other]), axis=1).T)
    return pairs == len(np.unique(one)) == len(np.unique(other))


# How numbers in single precision come from a file: as they are, turned by the node of a scene, moved by an offset in
# double precision, and in text.
STORED = {
    "single": lambda places: places,
    "turned": lambda places: places @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0],
    "with an offset": lambda places: places + np.array([500_000.25, 0, 0]),
    "in text": lambda places: np.round(places, 6),
}


CASES = [(stored, 0.0, scale) for stored in STORED for scale in (1.0, 1e4)]
CASES += [("single", 30.0, 1.0), ("single", 0.0, 1e-6)]


@pytest.mark.parametrize(("stored", "offset", "scale"), CASES)
def test_copies_that_differ_by_rounding_are_one(stored, offset, scale):
    places, faces, number = fallen_apart(*sheet(offset, scale), units=2)
    kept = STORED[stored](places.astype(np.float64))
    assert len(np.unique(kept, axis=0)) > SIDE * SIDE
    place_of, first = group_places(kept, None, faces)
    assert is_same_partition(place_of, number)
    assert np.array_equal(place_of[first], np.arange(len(first)))
    assert (np.diff(first) > 0).all()


def test_without_triangles_and_in_other_spaces_they_are_not():
    places, faces, number = fallen_apart(*sheet())
    exact = len(np.unique(places, axis=0))
    assert len(group_places(places.astype(np.float64), None)[1]) == exact
    spaces = (np.arange(len(places)) >= len(places) // 6 * 3).astype(np.int32)
    place_of, _ = group_places(places.astype(np.float64), spaces, faces)
    assert is_same_partition(place_of, 2 * number + spaces)


def test_vertices_that_an_edge_joins_stay_apart_however_short_it_is():
    """A sliver whose ends are one unit apart; its neighbours in space are copies of both of its ends."""
    places, faces = sheet()
    ends = faces[0, :2]
    places[ends[1]] = places[ends[0]]
    places[ends[1], 0] += np.spacing(np.float32(1))
    copies, corners, number = fallen_apart(places, faces, units=0)
    place_of, _ = group_places(copies.astype(np.float64), None, corners)
    assert is_same_partition(place_of, number)


def test_details_as_fine_as_the_rounding_stay():
    """Far from the origin edges are a few units in the last place long."""
    places, faces = sheet(offset=2.0**20, scale=2.0)
    alone, corners, _ = fallen_apart(places, faces, units=0)
    exact, _ = group_places(alone.astype(np.float64), None)
    assert np.array_equal(group_places(alone.astype(np.float64), None, corners)[0], exact)


def test_borders_that_are_further_apart_than_rounding_are_two():
    places, faces = sheet()
    shifted = places + np.float32([1, 0, 0]) + np.float32([2.0**-16, 0, 0])
    both = np.concatenate([places, shifted]).astype(np.float64)
    _, first = group_places(both, None, np.concatenate([faces, faces + len(places)]))
    assert len(first) == len(both)


def vertices(positions, faces, colours, space_of=None):
    colours, faces = np.asarray(colours, np.float32), np.asarray(faces, np.int32)
    names = tuple("rgb"[: colours.shape[1]])
    return ColouredVertices(positions, faces, colours, names, "srgb", "float32", space_of)


ROWS = st.tuples(st.integers(-2, 2), st.sampled_from((0.0, -0.0, 1.5, 1e-300)))


@given(st.lists(ROWS, min_size=1, max_size=40))
def test_equal_rows_are_numbered_in_the_order_of_their_first(rows):
    group_of, first = group_equal_rows(np.array([a for a, _ in rows]), np.array([b for _, b in rows]))
    seen = {}
    expected = [seen.setdefault(row, len(seen)) for row in rows]
    assert group_of.tolist() == expected
    assert [rows[i] for i in first] == list(seen)


def test_rows_with_equal_hashes_are_kept_apart(monkeypatch):
    monkeypatch.setattr(grouping, "mix_bits", lambda word: word & np.uint64(0))
    group_of, first = group_equal_rows(np.array([3, 1, 3, 2, 1]), np.array([0.0, 1.0, 0.0, 0.0, 2.0]))
    assert group_of.tolist() == [0, 1, 0, 2, 3]
    assert first.tolist() == [0, 1, 3, 4]


def test_vertices_in_different_spaces_are_not_joined():
    positions = np.zeros((4, 3))
    record = vertices(positions, [[0, 1, 2]], np.full((4, 3), 0.5), np.array([0, 0, 1, 1], np.int32))
    assert sample_vertices(record).sample_of.tolist() == [0, 0, 1, 1]


def sampled_surface(record):
    sampling = sample_vertices(record)
    return sampling.surface(record, record.colours[sampling.first_vertex])


def two_halves(jump):
    """A plane whose halves are split along the middle column, with a colour jump there."""
    side = 21
    positions, faces = surfaces.plane(side, side)
    left = faces[(positions[faces][:, :, 0] <= 10).all(axis=1)]
    right = faces[(positions[faces][:, :, 0] >= 10).all(axis=1)]
    count = len(positions)
    both = np.concatenate([positions, positions])
    grey = np.concatenate([np.full(count, 0.3), np.full(count, 0.3 + jump)])[:, None]
    return both, np.concatenate([left, right + count]), grey, count


def test_both_sides_of_a_hard_edge_keep_their_own_colour():
    positions, faces, colours, count = two_halves(0.5)
    result = beltrami_cli.smooth(positions, faces, colours, beta=30, t=1.0, iterations=3, space="data")
    assert result.hard_edge_samples == 21 * 21  # the unused halves of both copies stand apart as well
    used = np.unique(faces)
    middle = used[positions[used, 0] == 10]
    assert np.allclose(result.colours[middle[middle < count]], 0.3, atol=0.01)
    assert np.allclose(result.colours[middle[middle >= count]], 0.8, atol=0.01)


def test_the_surface_stays_connected_through_a_colour_jump():
    """A small jump is smoothed over, as it is where the mesh is not split."""
    positions, faces, colours, _ = two_halves(0.02)
    result = beltrami_cli.smooth(positions, faces, colours, beta=5, t=2.0, iterations=10, space="data")
    used = np.unique(faces)
    middle = result.colours[used[positions[used, 0] == 10], 0]
    assert np.ptp(middle) < 0.25 * 0.02
    apart = positions.copy()
    apart[len(positions) // 2 :, 2] += 50  # no longer coincident: two surfaces
    lonely = beltrami_cli.smooth(apart, faces, colours, beta=5, t=2.0, iterations=10, space="data").colours
    assert np.array_equal(lonely, colours)


def test_three_copies_of_an_edge_form_one_chain_and_walls_have_no_area():
    positions = np.array([[0, 0, 0], [0, 1, 0]] * 3 + [[1, 0, 0], [-1, 0, 0], [0, 0, 1]], float)
    faces = [[0, 1, 6], [2, 3, 7], [4, 5, 8]]
    colours = np.array([[0.9]] * 2 + [[0.1]] * 2 + [[0.5]] * 2 + [[0.5]] * 3)
    record = vertices(positions, faces, colours)
    surface = sampled_surface(record)
    assert len(surface.bridges) == 8
    walls = surface.colours[surface.bridges][:, :, 0].tolist()
    assert {tuple(round(v, 1) for v in sorted(set(wall))) for wall in walls} == {(0.1, 0.5), (0.5, 0.9)}


def test_copies_that_share_one_end_are_joined_by_a_single_triangle():
    positions = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]], float)
    faces = [[0, 1, 2], [0, 3, 4]]
    record = vertices(positions, faces, np.array([[0.5], [0.2], [0.2], [0.7], [0.7]]))
    surface = sampled_surface(record)
    assert len({frozenset(wall) for wall in surface.bridges.tolist()}) == 1
