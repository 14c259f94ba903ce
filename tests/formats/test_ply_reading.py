"""PLY files are read as trimesh reads them, in the dialects of scanners and libraries; damage is refused."""

import io
import struct

import numpy as np
import pytest
from trimesh.exchange.ply import load_ply

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import open_bytes, open_document
from beltrami_cli.surface.polygons import dual
from beltrami_cli.surface.records import ImageFile
from formats.gltf_files import joined, patched
from formats.ply_files import ENCODINGS, Table, build, coloured


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_mixed_polygons_keep_their_order_and_corners(encoding):
    random = np.random.default_rng(4)
    faces = [random.integers(0, 50, random.integers(0, 7)).tolist() for _ in range(200)]
    document = PlyDocument(build(coloured(50, faces), encoding).data, "x.ply")
    contents, vertices = document.contents(), document.coloured_vertices()
    assert contents.positions.tolist() == [[i, i * i, 0] for i in range(50)]
    assert (vertices.stored, vertices.encoding, vertices.channels) == (
        "uint8",
        "srgb",
        ("red", "green", "blue"),
    )
    np.testing.assert_allclose(vertices.colours, 10 / 255, rtol=1e-6)
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
    faces = PlyDocument(build(tables, encoding).data, "x.ply").coloured_vertices().faces
    assert faces.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4], [5, 6, 7]]


def test_intensity_in_range_is_grey_and_elsewhere_a_scalar_whose_full_scale_is_its_largest():
    tables = coloured(colour="float", value=0.25)
    tables[0].properties[3:] = [(name, "float") for name in ("intensity", "quality", "r")]
    vertices = PlyDocument(build(tables).data, "x.ply").coloured_vertices()
    assert vertices.channels == ("grey",)
    np.testing.assert_array_equal(vertices.colours, 0.25)
    tables[0].rows[1][3] = -2.5
    vertices = PlyDocument(build(tables).data, "x.ply").coloured_vertices()
    assert (vertices.channels, vertices.full_scale) == (("intensity",), 2.5)
    np.testing.assert_allclose(vertices.colours[:2, 0], [0.1, -1])


def asked_for(tables, *channels):
    """Open a file with the channels that are asked for."""
    return PlyDocument(build(tables).data, "x.ply", access=Access(channels=channels))


@pytest.mark.parametrize("kind", ["float", "double", "short", "ushort"])
def test_one_scalar_that_is_named_is_smoothed_in_place_of_colours(kind):
    tables = coloured()
    tables[0].properties += [("Quality", kind), ("label", "uchar")]
    for number, row in enumerate(tables[0].rows):
        row += [100 * number, 7]
    document = asked_for(tables, "quality")
    vertices = document.coloured_vertices()
    assert vertices.channels == ("quality",)
    values = [row[-2] for row in tables[0].rows]
    np.testing.assert_allclose(vertices.colours[:, 0] * vertices.full_scale, values, rtol=1e-6)
    assert patched(document, vertices.colours) == document.data
    changed = vertices.colours.copy()
    changed[1] = 0.5 * 100 / vertices.full_scale
    result = PlyDocument(patched(document, changed), "x.ply", access=document.access)
    values[1] = 50
    again = result.coloured_vertices()
    np.testing.assert_allclose(again.colours[:, 0] * again.full_scale, values, rtol=1e-6)
    assert result.fingerprint().parts == document.fingerprint().parts
    for channels in [("red",), ("r",), ("x",), ("quality", "label"), ()]:
        assert asked_for(tables, *channels).coloured_vertices().channels == ("red", "green", "blue")


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
    vertices = document.coloured_vertices()
    assert len(vertices.channels) == 1
    assert np.allclose(vertices.colours[:, 0], expected, atol=1e-4)
    colours = vertices.colours.copy()
    assert patched(document, colours) == data
    colours[1] = new
    values = [values[0], stored, values[2]]
    result = patched(document, colours)
    raw = load_ply(io.BytesIO(result))["metadata"]["_ply_raw"]["vertex"]["data"]
    assert np.allclose(raw["intensity"].ravel().astype(float), values, atol=1e-3)
    assert PlyDocument(result, "x.ply").fingerprint().parts == document.fingerprint().parts


@pytest.mark.parametrize("name", ["scalar_Intensity", "reflectance", "Intensity"])
def test_intensities_count_where_there_are_no_colours(name):
    tables = scan("float", [3, 5, 9], name)
    faces = Table("face", [("vertex_indices", "uchar int")], [[[0, 1, 2]]])
    for both in (tables, [*tables, faces]):
        assert PlyDocument(build(both).data, "x.ply").coloured_vertices().channels == ("intensity",)
    tables[0].properties += [("red", "uchar"), ("green", "uchar"), ("blue", "uchar")]
    for row in tables[0].rows:
        row += [1, 2, 3]
    assert PlyDocument(build(tables).data, "x.ply").coloured_vertices().channels == ("red", "green", "blue")


def read(data):
    document = PlyDocument(data, "bad.ply")
    vertices = document.coloured_vertices()
    document.contents()
    document.facts()
    assert np.isfinite(vertices.positions).all()
    assert np.isfinite(vertices.colours).all()
    assert vertices.faces.size == 0 or 0 <= vertices.faces.min() <= vertices.faces.max() < len(
        vertices.positions
    )
    patched(document, vertices.colours * 0.5)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_truncation_is_an_error(encoding):
    data = build(coloured(4, [[0, 1, 2], [0, 1, 2, 3]]), encoding).data
    # The last blanks of a text may go, and a shortened last token looks like a shorter number.
    whole = len(data.rstrip()) if encoding == "ascii" else len(data)
    for length in range(whole):
        with pytest.raises(InputError):
            read(data[:length])
    read(data)


def change(old, new, encoding="ascii"):
    data = build(coloured(), encoding).data
    assert old in data
    return data.replace(old, new, 1)


def of_colours(kind, value, encoding="ascii", row=slice(None)):
    """Return a file in which all colours, or one vertex's, have a value."""
    tables = coloured(colour=kind, value=0.5 if "f" in kind or "d" in kind else 10)
    for vertex in tables[0].rows[row]:
        vertex[3:] = [value] * 3
    return build(tables, encoding).data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (of_colours("char", 10), "no more than 127"), (of_colours("float", 1000.0), "neither 1 nor 255"),
        (of_colours("double", -1e130, "binary_little_endian"), "colour of vertex 0 is -1e+130, which is too large"),
        (of_colours("float", np.inf, "binary_big_endian", slice(2, 3)), "colour of vertex 2 is not finite"),
        (b"solid cube", "not a PLY file"), (b"ply\nformat ascii 1.0\n", "no line 'end_header'"),
        (change(b"format ascii 1.0\n", b""), "no line 'format'"),
        (change(b"ascii", b"binary_middle"), "line 2 of the header: 'format binary_middle 1.0'"),
        (change(b"vertex 4", b"vertex -4"), "line 3 of the header: '-4' is not a count"),
        (change(b"vertex 4", b"vertex 0"), "there are no vertices"),
        (change(b"vertex 4", b"vertex 123456789012345678"), "data end before the 123456789012345678 rows"),
        (change(b"face 2", b"face 999999999", ENCODINGS[1]), "data end before the 999999999 rows"),
        (change(b"float y", b"half y"), "line 5 of the header: 'half' is not a PLY type"),
        (change(b"float y", b"float x"), "two properties 'x'"),
        (change(b"element face", b"element vertex"), "announced twice"),
        (change(b"float y", b"float why"), "vertices have no property y"),
        (change(b"uchar red", b"char red"), "red, green, blue are of several types"),
        (change(b"uchar red", b"uchar rot"), "no vertex colours among the vertex properties x, y, z, rot"),
        (change(b"1 1 0 10", b"1 nan 0 10"), "the position of vertex 1 is not finite"),
        (change(b"1 1 0 10", b"1 1 0 256"), "property 'red' of element 'vertex': 256 in row 1 is not of type uint8"),
        (change(b"1 1 0 10", b"1 1 0 9.5"), "9.5 in row 1 is not of type uint8"),
        (change(b"1 1 0 10", b"1 one 0 10"), "data end before"),
        (change(b"3 0 2 3", b"3 0 2 4"), "face 1 refers to vertex 4, but there are 4 vertices"),
        (change(b"3 0 2 3", b"3 0 -2 3"), "face 1 refers to vertex -2"),
        (change(b"3 0 2 3", b"-3 0 2 3"), "row 1 of element 'face' has a list of -3 items"),
        (change(b"3 0 2 3", b"3.5 0 2 3"), "has a list of 3.5 items"),
        (change(b"vertex_indices", b"corners"), "element 'face' has no list vertex_indices"),
        (change(b"uchar int vertex", b"float int vertex"), "count of a list cannot be a float"),
        (change(b"uchar int vertex", b"uchar float vertex"), "not whole numbers"),
    ],
)  # fmt: skip
def test_the_message_names_the_cause_and_the_place(data, message):
    with pytest.raises(InputError) as caught:
        read(data)
    assert message in str(caught.value)
    assert str(caught.value).startswith("bad.ply: ")


XYZ = [("x", "float"), ("y", "float"), ("z", "float")]
SIDE = 9
CORNERS = [[a, a + 1, a + SIDE + 1, a + SIDE] for a in range(SIDE * (SIDE - 1)) if a % SIDE < SIDE - 1]
PLACES = [[n % SIDE, n // SIDE, 0] for n in range(SIDE * SIDE)]
COLOURS = np.random.default_rng(1).integers(60, 180, (SIDE * SIDE, 3)).tolist()


def grid(properties, values, of_faces=(), faces=None):
    rows = [[*place, *value] for place, value in zip(PLACES, values, strict=True)]
    polygons = [[corners, *(faces or [[]] * len(CORNERS))[n]] for n, corners in enumerate(CORNERS)]
    kinds = [("vertex_indices", "uchar int"), *of_faces]
    return [Table("vertex", [*XYZ, *properties], rows), Table("face", kinds, polygons)]


def named(names, kind):
    return [(name, kind) for name in names.split()]


def packed(colour, kind):
    r, g, b = colour
    number = struct.pack("<I", r << 16 | g << 8 | b)
    return [struct.unpack("<f" if kind == "float" else "<I", number)[0]]


def changed(document):
    """Return a document with other colours, of which nothing else may differ."""
    colours = document.coloured_vertices().colours
    assert patched(document, colours) == patched(document, None) == document.data
    again = open_bytes(patched(document, 1 - colours), "out.ply", None)
    assert again.fingerprint().parts == document.fingerprint().parts
    return again


DIALECTS = {
    "Red": (named("Red Green Blue", "uchar"), lambda c: c),
    "scalar_R": (named("scalar_R scalar_G scalar_B", "float"), lambda c: [*map(float, c)]),
    "int": (named("red green blue", "int"), lambda c: c),
    "list": ([("color", "uchar uchar")], lambda c: [c]),
    "list of four": ([("colors", "uchar uchar")], lambda c: [[*c, 255]]),
    "packed": ([("rgba", "uint")], lambda c: packed(c, "uint")),
    "packed float": ([("rgb", "float"), ("quality", "float")], lambda c: [*packed(c, "float"), 0.5]),
}


# Packed colours are never text.
@pytest.mark.parametrize(
    ("dialect", "encoding"),
    [(d, e) for d in DIALECTS for e in ENCODINGS if not (d.startswith("packed") and e == "ascii")],
)
def test_colours_under_other_names_are_the_same(dialect, encoding):
    properties, value = DIALECTS[dialect]
    data = build(grid(properties, [value(colour) for colour in COLOURS]), encoding).data
    document = open_bytes(data, "in.ply", None)
    np.testing.assert_allclose(document.coloured_vertices().colours, np.array(COLOURS) / 255, atol=1e-6)
    np.testing.assert_allclose(
        changed(document).coloured_vertices().colours, 1 - np.array(COLOURS) / 255, atol=1e-6
    )
    assert ("rgb" in str(document.attributes())) <= dialect.startswith("packed")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_colours_of_faces_stay_colours_of_faces(encoding):
    levels = np.random.default_rng(2).integers(60, 180, (len(CORNERS), 3))
    tables = grid([], [[]] * len(PLACES), named("red green blue", "uchar"), levels.tolist())
    document = open_bytes(build(tables, encoding).data, "in.ply", None)
    np.testing.assert_allclose(document.coloured_vertices().colours, levels / 255, atol=1e-6)
    np.testing.assert_allclose(changed(document).coloured_vertices().colours, 1 - levels / 255, atol=1e-6)
    assert document.contents().colours.shape == document.contents().positions.shape == (len(PLACES), 3)


def test_the_dual_of_a_grid_of_squares_is_a_smaller_grid():
    # Each of the (n - 1)² squares is a vertex; around each of the (n - 2)² inner vertices lie two triangles.
    corners = np.array(CORNERS, np.int32)
    centres, triangles = dual(np.array(PLACES, float), corners.ravel(), 4 * np.arange(len(corners) + 1))
    assert sorted(map(tuple, centres)) == [
        (x + 0.5, y + 0.5, 0) for x in range(SIDE - 1) for y in range(SIDE - 1)
    ]
    a, b, c = centres[triangles].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    np.testing.assert_allclose(areas, 0.5)  # all turned as the squares are
    assert len(areas) == 2 * (SIDE - 2) ** 2


@pytest.mark.parametrize("spelling", ["1.#QNAN", "-1.#IND", "1.#INF00", "-nan(ind)"])
@pytest.mark.parametrize("suffix", ["ply", "xyz"])
def test_numbers_that_are_none_are_known_as_microsoft_spells_them(suffix, spelling):
    points = [[*place, *colour] for place, colour in zip(PLACES, COLOURS, strict=True)]
    points[5][:3] = [spelling] * 3
    data = build([Table("vertex", [*XYZ, *named("red green blue", "uchar")], points)]).data
    data = data if suffix == "ply" else data[data.index(b"end_header\n") + 11 :]
    document = open_bytes(data, f"in.{suffix}", None)
    new = patched(document, 1 - document.coloured_vertices().colours)
    assert new != data
    assert new.count(spelling.encode()) == 3


def artec():
    """Artec's elements, whose texture faces are in another order than the faces."""
    tables = grid([], [[]] * len(PLACES))
    uv = [[0, x / (SIDE - 1), y / (SIDE - 1)] for x, y, _ in PLACES]
    faces = [[0, n, corners] for n, corners in reversed([*enumerate(CORNERS)])]
    kinds = [("tx", "uchar"), ("tn", "uint"), ("texture_vertex_indices", "uchar int")]
    vertices = Table("multi_texture_vertex", [("tx", "uchar"), ("u", "float"), ("v", "float")], uv)
    return [*tables, vertices, Table("multi_texture_face", kinds, faces)]


def listed(name):
    flat = [
        [[x for a in corners for x in (a % SIDE / (SIDE - 1), a // SIDE / (SIDE - 1))]] for corners in CORNERS
    ]
    return grid([], [[]] * len(PLACES), [(name, "uchar float")], flat)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_texture_coordinates_of_all_dialects_are_the_same(tmp_path, encoding):
    (tmp_path / "t.png").write_bytes(b"an image")
    of_vertices = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
    shares = [[x / (SIDE - 1), y / (SIDE - 1)] for x, y, _ in PLACES]
    dialects = [artec(), *map(listed, ("t", "TexCoord", "uv", "texture_uv"))]
    for tables in (*dialects, *(grid(named(" ".join(names), "float"), shares) for names in of_vertices)):
        (tmp_path / "in.ply").write_bytes(build(tables, encoding, comments=["TextureFile t.png"]).data)
        document = open_document(str(tmp_path / "in.ply"))
        assert (document.has_vertex_colours(), document.slots()) == (False, ("baseColor",))
        assert list(document.references()) == ["t.png"]
        with pytest.raises(InputError, match="no normal texture"):
            document.textured("normal")
        surface = document.textured("baseColor")
        shown = surface.positions[surface.faces][..., :2] / (SIDE - 1)
        np.testing.assert_allclose(surface.uv[..., 0], shown[..., 0], atol=1e-6)
        np.testing.assert_allclose(1 - surface.uv[..., 1], shown[..., 1], atol=1e-6)
        assert [texture.data for texture in surface.textures] == [b"an image"]
        assert [texture.data for texture in document.fingerprint().images.values()] == [b"an image"]
        images = {("baseColor", "t.png"): ImageFile(b"new", ".png")}
        written = document.patch(None, Naming("in", in_place=True), images=images)
        assert (joined(written), dict(written.sidecars)) == (document.data, {"t.png": b"new"})


def test_gaussian_splats_are_refused_by_name():
    names = "f_dc_0 f_dc_1 f_dc_2 opacity scale_0 rot_0"
    tables = [Table("vertex", [*XYZ, *named(names, "float")], [[0] * 9])]
    with pytest.raises(InputError, match="Gaussian splats"):
        open_bytes(build(tables, ENCODINGS[1]).data, "in.ply", None).coloured_vertices()
