"""Copies of a vertex that differ by rounding count as one; what edges join, or lies further apart, does not."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli import SmoothSettings, smooth_file
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.grouping import group_places
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


@pytest.mark.parametrize(
    ("stored", "offset", "scale"),
    [
        *((stored, 0.0, scale) for stored in STORED for scale in (1.0, 1e4)),
        ("single", 30.0, 1.0),
        ("single", 0.0, 1e-6),
    ],
)
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
    spaces = np.repeat(
        np.arange(2, dtype=np.int32), [len(places) // 6 * 3, len(places) - len(places) // 6 * 3]
    )
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


def test_a_surface_that_fell_apart_is_smoothed_like_the_whole(tmp_path):
    settings = SmoothSettings(kernel=KernelParameters(iterations=3, t=4.0, beta=4.0, metric_steps=0, free=()))
    random = np.random.default_rng(3)
    colours = np.clip(random.normal(0.5, 0.05, (SIDE * SIDE, 3)), 0, 1)
    found = {}
    for units in (0, 1):
        copies, faces, number = fallen_apart(*sheet(), units=units)
        table = np.column_stack([copies.astype(np.float64), colours[number]])
        lines = ["v " + " ".join(f"{value:.9g}" for value in row) for row in table]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
        source = tmp_path / f"{units}.obj"
        source.write_text("\n".join([*lines, ""]))
        smooth_file(source, tmp_path / f"{units}-out.obj", settings)
        found[units] = open_document(str(tmp_path / f"{units}-out.obj")).painted().colours
    assert np.abs(found[0] - colours[number]).mean() > 0.01
    # Lengths are measured between positions that differ by rounding.
    assert np.abs(found[1] - found[0]).max() < 1e-4
