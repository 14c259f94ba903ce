"""PLY files as scanners and libraries write them: the same colours under other names give the same result."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.geometry import dual
from cli.commands import beltrami, refused
from formats.image_files import encode
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


def smoothed(folder, tables, encoding, comments=None):
    """Smooth a file, check that nothing but colours changed, and return them with full scale 255."""
    (folder / "in.ply").write_bytes(build(tables, encoding, comments=comments).data)
    beltrami("smooth", "in.ply", "out.ply", "--overwrite", "--noise", 20, cwd=folder)
    assert "nothing else differs" in beltrami("check", "in.ply", "out.ply", cwd=folder, text=True).stdout
    return open_document(str(folder / "out.ply"))


DIALECTS = {
    "Red": (three("Red Green Blue", "uchar"), lambda c: c),
    "scalar_R": (three("scalar_R scalar_G scalar_B", "float"), lambda c: [*map(float, c)]),
    "int": (three("red green blue", "int"), lambda c: c),
    "list": ([("color", "uchar uchar")], lambda c: [c]),
    "list of four": ([("colors", "uchar uchar")], lambda c: [[*c, 255]]),
    "packed": ([("rgba", "uint")], lambda c: packed(c, "uint")),
    "packed float": ([("rgb", "float"), ("quality", "float")], lambda c: [*packed(c, "float"), 0.5]),
}


# Each dialect in two of the three encodings; packed colours are never text.
PAIRS = [(d, e) for i, d in enumerate(DIALECTS) for j, e in enumerate(ENCODINGS) if (i + j) % 3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dialect", "encoding"), [(d, e) for d, e in PAIRS if not (d.startswith("packed") and e == "ascii")]
)
def test_colours_under_other_names_are_smoothed_the_same(tmp_path, dialect, encoding):
    plain = smoothed(tmp_path, grid(three("red green blue", "uchar"), COLOURS), encoding).painted().colours
    properties, value = DIALECTS[dialect]
    document = smoothed(tmp_path, grid(properties, [value(colour) for colour in COLOURS]), encoding)
    # Whole numbers are rounded, by half a step of 255 at most.
    np.testing.assert_allclose(document.painted().colours, plain, atol=0.501 / 255 if "R" in dialect else 0)
    assert ("rgb" in str(document.attributes())) <= dialect.startswith("packed")
    beltrami("smooth", "out.ply", "o.glb", cwd=tmp_path)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_colours_of_faces_are_smoothed_across_edges_and_stay_colours_of_faces(tmp_path, encoding):
    rng = np.random.default_rng(2)
    noisy = np.clip(np.rint(120 + 20 * rng.standard_normal((len(CORNERS), 3))), 0, 255).astype(int).tolist()
    tables = grid([], [[]] * len(PLACES), three("red green blue", "uchar"), noisy)
    document = smoothed(tmp_path, tables, encoding)
    assert document.painted().colours.shape == (len(CORNERS), 3)
    assert document.painted().colours.std() * 255 < 10  # half of the noise
    beltrami("smooth", "in.ply", "o.glb", cwd=tmp_path)
    assert open_document(str(tmp_path / "o.glb")).painted().positions.shape == (len(PLACES), 3)


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
def test_numbers_that_are_none_are_known_as_microsoft_spells_them(tmp_path, suffix, spelling):
    points = [[*place, *colour] for place, colour in zip(PLACES, COLOURS, strict=True)]
    points[5][:3] = [spelling] * 3
    data = build([Table("vertex", [*XYZ, *three("red green blue", "uchar")], points)]).data
    data = data if suffix == "ply" else data[data.index(b"end_header\n") + 11 :]
    (tmp_path / f"in.{suffix}").write_bytes(data)
    beltrami("smooth", f"in.{suffix}", f"out.{suffix}", "--noise", 20, cwd=tmp_path)
    new = (tmp_path / f"out.{suffix}").read_bytes()
    assert new != data
    assert new.count(spelling.encode()) == 3
    assert (
        "nothing else" in beltrami("check", f"in.{suffix}", f"out.{suffix}", cwd=tmp_path, text=True).stdout
    )


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encoding", "names"),
    list(zip(ENCODINGS, [("t", "TexCoord"), ("uv", "t"), ("texture_uv", "uv")], strict=True)),
)
def test_texture_coordinates_of_all_dialects_are_the_same(tmp_path, encoding, names):
    pixels = np.rint(120 + 20 * np.random.default_rng(3).standard_normal((24, 24, 3))).astype(np.uint8)
    (tmp_path / "t.png").write_bytes(encode(pixels, "png"))
    expected = None
    for tables in (artec(), *map(listed, names)):
        surface = smoothed(tmp_path, tables, encoding, ["TextureFile t.png"]).textured("baseColor")
        shown = surface.positions[surface.faces][..., :2] / (SIDE - 1)
        np.testing.assert_allclose(surface.uv[..., 0], shown[..., 0], atol=1e-6)
        np.testing.assert_allclose(1 - surface.uv[..., 1], shown[..., 1], atol=1e-6)
        data = [texture.data for texture in surface.textures]
        assert data == (expected := expected or data)


def test_gaussian_splats_are_refused_by_name(tmp_path):
    names = "f_dc_0 f_dc_1 f_dc_2 opacity scale_0 rot_0"
    tables = [Table("vertex", [*XYZ, *three(names, "float")], [[0] * 9])]
    (tmp_path / "in.ply").write_bytes(build(tables, ENCODINGS[1]).data)
    refused(tmp_path, "smooth", "in.ply", "out.ply", code=3, said="Gaussian splats")
