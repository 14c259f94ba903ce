"""Intensities of scans in PLY files without faces: of any type and range, and the only thing that changes."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.formats.ply import PlyDocument
from formats.ply_files import ENCODINGS, Table, build


def scan(kind, values, name="intensity"):
    properties = [("x", "float"), ("y", "float"), ("z", "float"), (name, kind), ("label", "uchar")]
    return [Table("vertex", properties, [[i, i, 0, value, 7] for i, value in enumerate(values)])]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("kind", "values", "expected", "new", "stored"),
    [
        ("float", [0, 0.5, 1], [0, 0.5, 1], 0.25, 0.25),
        ("float", [0, 1000.5, -2001], [0, 0.5, -1], 0.25, 500.25),
        ("double", [0, 51, 255], [0, 0.2, 1], 0.4, 102),
        ("short", [-2048, 1024, 2047], [-1, 0.5, 2047 / 2048], -0.25, -512),
        ("ushort", [0, 13107, 65535], [0, 0.2, 1], 0.4, 26214),
        ("uchar", [0, 51, 255], [0, 0.2, 1], 0.4, 102),
        ("int", [0, 4095, 65535], [0, 4095 / 65535, 1], 0.4, 26214),
    ],
)
def test_intensities_of_points_are_of_any_type_and_range(encoding, kind, values, expected, new, stored):
    document = PlyDocument(build(scan(kind, values), encoding).data, "x.ply")
    painted = document.painted()
    assert len(painted.channels) == 1
    assert np.allclose(painted.colours[:, 0], expected, atol=1e-4)
    colours = painted.colours.copy()
    assert b"".join(document.patch(colours, "x", moved=False).main) == document._data
    colours[1] = new
    values = [values[0], stored, values[2]]
    result = b"".join(document.patch(colours, "x", moved=False).main)
    again = PlyDocument(result, "x.ply")
    assert np.allclose(again._vertices.scalars("intensity").astype(float), values, atol=1e-3)
    assert again.fingerprint().parts == document.fingerprint().parts


@pytest.mark.parametrize("name", ["scalar_Intensity", "reflectance", "Intensity"])
def test_other_names_of_intensities_are_known_where_there_are_no_faces(name):
    tables = scan("float", [3, 5, 9], name)
    assert PlyDocument(build(tables).data, "x.ply").painted().channels == ("intensity",)
    tables.append(Table("face", [("vertex_indices", "uchar int")], [[[0, 1, 2]]]))
    assert not PlyDocument(build(tables).data, "x.ply").has_vertex_colours()


def test_colours_count_more_than_intensities():
    tables = scan("float", [3, 5, 9])
    tables[0].properties += [("red", "uchar"), ("green", "uchar"), ("blue", "uchar")]
    for row in tables[0].rows:
        row += [1, 2, 3]
    assert PlyDocument(build(tables).data, "x.ply").painted().channels == ("red", "green", "blue")
