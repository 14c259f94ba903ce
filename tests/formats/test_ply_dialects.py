"""PLY files as scanners and libraries write them: the same colours under other names give the same result."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.registry import open_bytes, open_document
from beltrami_cli.surface.geometry import dual
from beltrami_cli.surface.records import ImageFile
from formats.gltf_files import joined
from formats.patching import patched
from formats.ply_files import ENCODINGS, Table, build

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


def three(names, kind):
    return [(name, kind) for name in names.split()]


def packed(colour, kind):
    r, g, b = colour
    number = struct.pack("<I", r << 16 | g << 8 | b)
    return [struct.unpack("<f" if kind == "float" else "<I", number)[0]]


def changed(document):
    """Return a document with other colours, of which nothing else may differ."""
    colours = document.painted().colours
    assert patched(document, colours) == patched(document, None) == document.data
    again = open_bytes(patched(document, 1 - colours), "out.ply", None)
    assert again.fingerprint().parts == document.fingerprint().parts
    return again


DIALECTS = {
    "Red": (three("Red Green Blue", "uchar"), lambda c: c),
    "scalar_R": (three("scalar_R scalar_G scalar_B", "float"), lambda c: [*map(float, c)]),
    "int": (three("red green blue", "int"), lambda c: c),
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
    np.testing.assert_allclose(document.painted().colours, np.array(COLOURS) / 255, atol=1e-6)
    np.testing.assert_allclose(changed(document).painted().colours, 1 - np.array(COLOURS) / 255, atol=1e-6)
    assert ("rgb" in str(document.attributes())) <= dialect.startswith("packed")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_colours_of_faces_stay_colours_of_faces(encoding):
    levels = np.random.default_rng(2).integers(60, 180, (len(CORNERS), 3))
    tables = grid([], [[]] * len(PLACES), three("red green blue", "uchar"), levels.tolist())
    document = open_bytes(build(tables, encoding).data, "in.ply", None)
    np.testing.assert_allclose(document.painted().colours, levels / 255, atol=1e-6)
    np.testing.assert_allclose(changed(document).painted().colours, 1 - levels / 255, atol=1e-6)
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
    data = build([Table("vertex", [*XYZ, *three("red green blue", "uchar")], points)]).data
    data = data if suffix == "ply" else data[data.index(b"end_header\n") + 11 :]
    document = open_bytes(data, f"in.{suffix}", None)
    new = patched(document, 1 - document.painted().colours)
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
    for tables in (artec(), *map(listed, ("t", "TexCoord", "uv", "texture_uv"))):
        (tmp_path / "in.ply").write_bytes(build(tables, encoding, comments=["TextureFile t.png"]).data)
        document = open_document(str(tmp_path / "in.ply"))
        surface = document.textured("baseColor")
        shown = surface.positions[surface.faces][..., :2] / (SIDE - 1)
        np.testing.assert_allclose(surface.uv[..., 0], shown[..., 0], atol=1e-6)
        np.testing.assert_allclose(1 - surface.uv[..., 1], shown[..., 1], atol=1e-6)
        assert [texture.data for texture in surface.textures] == [b"an image"]
        images = {("baseColor", "t.png"): ImageFile(b"new", ".png")}
        written = document.patch(None, Naming("in", keeps=True), images=images)
        assert (joined(written), dict(written.sidecars)) == (document.data, {"t.png": b"new"})


def test_gaussian_splats_are_refused_by_name():
    names = "f_dc_0 f_dc_1 f_dc_2 opacity scale_0 rot_0"
    tables = [Table("vertex", [*XYZ, *three(names, "float")], [[0] * 9])]
    with pytest.raises(InputError, match="Gaussian splats"):
        open_bytes(build(tables, ENCODINGS[1]).data, "in.ply", None).painted()
