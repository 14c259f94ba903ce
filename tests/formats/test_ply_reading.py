"""PLY files are read as trimesh reads them where it is right; intensities are colours of any type and range."""

from __future__ import annotations

import io

import numpy as np
import pytest
from trimesh.exchange.ply import load_ply

from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.ply.document import PlyDocument
from formats.ply_files import ENCODINGS, Table, build, coloured


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_reading_agrees_with_trimesh(encoding):
    random = np.random.default_rng(3)
    tables = coloured(30, random.integers(0, 30, (40, 3)).tolist())
    for row in tables[0].rows:
        row[:] = [*random.normal(size=3).astype(np.float32).tolist(), *random.integers(0, 256, 3).tolist()]
    data = build(tables, encoding).data
    painted = PlyDocument(data, "x.ply").painted()
    other = load_ply(io.BytesIO(data))  # trimesh.load drops vertices without a face in some versions
    np.testing.assert_allclose(painted.positions, other["vertices"], rtol=1e-7)
    np.testing.assert_array_equal(painted.faces, other["faces"])
    np.testing.assert_array_equal(np.rint(painted.colours * 255), other["vertex_colors"][:, :3])
    assert (painted.stored, painted.encoding, painted.channels) == ("uint8", "srgb", ("red", "green", "blue"))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_mixed_polygons_keep_their_order_and_corners(encoding):
    random = np.random.default_rng(4)
    faces = [random.integers(0, 50, random.integers(0, 7)).tolist() for _ in range(200)]
    contents = PlyDocument(build(coloured(50, faces), encoding).data, "x.ply").contents()
    read = [
        contents.corners[a:b].tolist() for a, b in zip(contents.offsets, contents.offsets[1:], strict=False)
    ]
    assert read == faces


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_strips_are_unrolled_with_one_orientation(encoding):
    tables = coloured(8, [])
    tables[1] = Table(
        "tristrips", [("vertex_indices", "int int")], [[[0, 1, 2, 3, 4, -1, 5, 6, 7, -1, 1, 2, 2, 3]]]
    )
    faces = PlyDocument(build(tables, encoding).data, "x.ply").painted().faces
    assert faces.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4], [5, 6, 7]]


def test_points_have_no_faces_and_lines_may_end_as_on_old_macs():
    assert PlyDocument(build(coloured()[:1]).data, "x.ply").painted().faces.shape == (0, 3)
    built = build(coloured(), "binary_little_endian", "\r")
    document = PlyDocument(built.data, "x.ply")
    assert len(document.painted().positions) == 4
    assert document.painted() is document.painted()


def test_grey_intensity_in_range_is_a_colour_and_elsewhere_a_scalar():
    tables = coloured(colour="float", value=0.25)
    tables[0].properties = [
        *tables[0].properties[:3],
        ("intensity", "float"),
        ("quality", "float"),
        ("r", "float"),
    ]
    painted = PlyDocument(build(tables).data, "x.ply").painted()
    assert painted.channels == ("grey",)
    np.testing.assert_array_equal(painted.colours, 0.25)
    tables[0].rows[1][3] = 1.5
    with pytest.raises(Exception, match="no vertex colours among the vertex properties x, y, z, intensity"):
        PlyDocument(build(tables).data, "x.ply").painted()


def test_what_conversion_drops_is_listed():
    tables = coloured()
    tables[0].properties.append(("quality", "float"))
    for row in tables[0].rows:
        row.append(1)
    tables.append(Table("edge", [("vertex1", "int")], [[0]]))
    contents = PlyDocument(build(tables, comments=["hello"]).data, "x.ply").contents()
    assert contents.left_out == ("vertex properties quality", "element edge", "comments")


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
    data = build(scan(kind, values), encoding).data
    document = PlyDocument(data, "x.ply")
    painted = document.painted()
    assert len(painted.channels) == 1
    assert np.allclose(painted.colours[:, 0], expected, atol=1e-4)
    colours = painted.colours.copy()
    assert b"".join(document.patch(colours, Naming("x")).main) == data
    colours[1] = new
    values = [values[0], stored, values[2]]
    result = b"".join(document.patch(colours, Naming("x")).main)
    raw = load_ply(io.BytesIO(result))["metadata"]["_ply_raw"]["vertex"]["data"]
    assert np.allclose(raw["intensity"].ravel().astype(float), values, atol=1e-3)
    assert PlyDocument(result, "x.ply").fingerprint().parts == document.fingerprint().parts


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
