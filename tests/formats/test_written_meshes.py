"""Meshes and points written as new files are read back the same, and what a format cannot hold is said."""

import dataclasses
import io

import numpy as np
import pytest
import trimesh

from beltrami_cli.errors import InputError
from beltrami_cli.formats.output_format import write_mesh
from beltrami_cli.formats.registry import FORMATS, open_bytes
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.records import MeshContents
from formats.gltf_files import joined, numbers, unpacked

# tests/formats/test_usd.py writes USD.
WRITABLE = [line for line in FORMATS if line.writer and line.reader != "usd"]
FORMS = [line.name for line in WRITABLE]
MESHES = [line.name for line in WRITABLE if line.has_textures]
OF_SINGLE_PRECISION = ("glb", "gltf")
NORMALS = ("ply", "glb", "gltf", "xyz", "csv")
ALPHA = ("ply", "glb", "gltf", "npz")
FULL = {"uint8": 255, "uint16": 65535}


def mesh(sizes=(3,), stored="uint8", channels=3, encoding="srgb", dtype=np.float32, **changes):
    """Return vertices with random polygons of some sizes; without any they are points."""
    random = np.random.default_rng(5)
    colours = random.random((300, channels), np.float32)
    if stored in FULL:
        colours = np.rint(colours * FULL[stored]) / np.float32(FULL[stored])
    contents = MeshContents(
        positions=random.normal(size=(300, 3)).astype(dtype).astype(np.float64),
        corners=random.integers(0, 300, sum(sizes)).astype(np.int32),
        offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        colours=colours.astype(np.float32),
        encoding=encoding,
        stored=stored,
    )
    return dataclasses.replace(contents, **changes)


def triangles(contents):
    """Return how many triangles the polygons of a mesh are cut into."""
    return int(np.maximum(np.diff(contents.offsets) - 2, 0).sum())


CONTENTS = [
    ("uint8", "srgb", 3, np.float32, False), ("uint8", "linear", 1, np.float64, True),
    ("uint16", "srgb", 1, np.float32, True), ("uint16", "linear", 3, np.float32, False),
    ("float32", "srgb", 3, np.float64, True), ("float32", "linear", 3, np.float32, True),
    ("text", "srgb", 3, np.float64, False),
]  # fmt: skip


@pytest.mark.parametrize(("stored", "encoding", "channels", "dtype", "has_more"), CONTENTS)
@pytest.mark.parametrize("form", FORMS)
def test_what_is_written_is_read_back(tmp_path, form, stored, encoding, channels, dtype, has_more):
    dtype = np.float32 if form in OF_SINGLE_PRECISION else dtype
    sizes = (3, 4, 300, 3, 7) if form in MESHES else (3, 3) if form == "npz" else ()
    sizes = () if stored == "text" else sizes
    contents = mesh(sizes, stored, channels, encoding, dtype)
    if has_more:
        normals = np.random.default_rng(6).normal(size=(300, 3))
        normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
        alpha = (np.arange(300) % 256 / 255).astype(np.float32)
        contents = dataclasses.replace(contents, normals=normals, alpha=alpha)
    written = write_mesh(contents, form, "s t")
    for name, data in written.sidecars.items():
        (tmp_path / name).write_bytes(bytes(data))
    document = open_bytes(joined(written), f"s t.{form}", tmp_path)
    found = document.contents()
    np.testing.assert_array_equal(found.positions.astype(dtype), contents.positions)
    if form in ("obj", "ply"):
        np.testing.assert_array_equal(found.corners, contents.corners)
        np.testing.assert_array_equal(found.offsets, contents.offsets)
    assert triangles(found) == triangles(contents)
    seen, wanted = (
        linear_to_srgb(each.colours) if each.encoding == "linear" else each.colours
        for each in (found, contents)
    )
    np.testing.assert_allclose(
        seen, np.broadcast_to(wanted, seen.shape), rtol=0, atol=rounding(form, stored, encoding)
    )
    assert (found.alpha is None) == (not has_more or form not in ALPHA)
    if has_more and form in NORMALS:
        np.testing.assert_allclose(document.attribute("normal"), contents.normals, atol=1e-6)
    if has_more and form in ALPHA:
        np.testing.assert_allclose(found.alpha, contents.alpha, atol=1e-6)
    said = " ".join(written.notices)
    assert ("Opacity is dropped" in said) == (has_more and form not in ALPHA)
    if encoding == "linear" and form not in OF_SINGLE_PRECISION:
        assert "Linear colours are written as sRGB" in said
        assert stored != "uint8" or len(np.unique(found.colours)) == len(np.unique(contents.colours))
    assert ("Grey" in said) == (channels == 1)


def rounding(form, stored, encoding):
    """Return the tolerance of sRGB colours: half a stored level, or half of the last digit of text."""
    if form in ("obj", "xyz", "pts", "csv"):
        return 5.1e-7
    if encoding == "linear" and form in ("ply", "npz") and stored in FULL:
        return 0.51 / 65535
    if form in OF_SINGLE_PRECISION and (stored, encoding) == ("uint8", "srgb"):
        return 12.93 * 0.5 / 65535  # near black, where the slope of sRGB is 12.92
    return 1e-6


@pytest.mark.parametrize("stored", FULL)
def test_every_srgb_level_comes_back_from_the_linear_light_of_gltf(stored):
    top = FULL[stored]
    levels = np.arange(top + 1)
    grey = np.repeat((levels / top)[:, None], 3, axis=1).astype(np.float32)
    points = mesh((), stored, positions=np.zeros((top + 1, 3)), colours=grey, alpha=grey[:, 0])
    contents = open_bytes(joined(write_mesh(points, "glb", "x")), "x.glb", None).contents()
    back = np.rint(linear_to_srgb(contents.colours.astype(np.float64)) * top)
    np.testing.assert_array_equal(back, np.repeat(levels[:, None], 3, axis=1))
    np.testing.assert_array_equal(np.rint(contents.alpha.astype(np.float64) * top), levels)


@pytest.mark.parametrize(
    ("form", "stored", "encoding", "kept"),
    [("glb", stored, "linear", stored) for stored in ("uint8", "uint16", "float32")]
    + [
        ("ply", "uint8", "srgb", "uint8"),
        ("ply", "uint8", "linear", "uint16"),
        ("ply", "float32", "linear", "float32"),
    ],
)
def test_colours_keep_a_type_that_holds_them(form, stored, encoding, kept):
    written = write_mesh(mesh(stored=stored, encoding=encoding), form, "x")
    assert open_bytes(joined(written), f"x.{form}", None).coloured_vertices().stored == kept


@pytest.mark.parametrize(("name", "scale", "digits", "kept"), [
    ("x.obj", 255, 5, "uint8"), ("x.xyz", 1, 0, "uint8"), ("x.csv", 255, 6, "uint8"), ("x.obj", 255.5, 6, "float32"),
    ("x.ply", 1, 0, "uint8"),
])  # fmt: skip
def test_colours_become_bytes_where_these_hold_them(name, scale, digits, kept):
    levels = np.arange(256.0).reshape(-1, 1) * [1, 1, 1]
    rows = np.column_stack([levels * [1, 0, 0], (levels / scale).round(digits)]).tolist()
    text = "\n".join("v " * name.endswith("obj") + " ".join(map(str, row)) for row in rows)
    if name == "x.ply":
        shorts = (
            f"property {kind}" for kind in ("float x", "float y", "float z", "short r", "short g", "short b")
        )
        text = "\n".join(["ply", "format ascii 1.0", "element vertex 256", *shorts, "end_header", text, ""])
    document = open_bytes(text.encode(), name, None)
    written = joined(write_mesh(document.vertex_mesh(), "ply", "x"))
    found = open_bytes(written, "x.ply", None).coloured_vertices()
    assert found.stored == kept
    np.testing.assert_allclose(found.colours, levels / (scale if scale > 1 else 255), atol=0.5e-5)


def test_opacity_is_not_rounded_to_bytes_with_colours_that_are_bytes():
    text = "v 0 0 0 0 0 1 0.123456\nv 1 0 0 0 1 0 0.5\n"
    document = open_bytes(text.encode(), "x.obj", None)
    written = open_bytes(joined(write_mesh(document.vertex_mesh(), "ply", "x")), "x.ply", None)
    np.testing.assert_allclose(written.vertex_mesh().alpha, [0.123456, 0.5], atol=1e-7)


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_small_coordinates_and_more_polygons_than_a_block_are_read_back(form):
    contents = mesh(np.random.default_rng(8).integers(3, 7, 70_000), dtype=np.float64)
    contents = dataclasses.replace(contents, positions=contents.positions * 1e-7)
    found = open_bytes(joined(write_mesh(contents, form, "x")), f"x.{form}", None).contents()
    np.testing.assert_array_equal(found.positions, contents.positions)
    np.testing.assert_array_equal(found.corners, contents.corners)


def test_positions_in_ply_are_doubles_only_where_floats_would_lose():
    assert b"property float x" in joined(write_mesh(mesh(), "ply", "out"))
    assert b"property double x" in joined(write_mesh(mesh(dtype=np.float64), "ply", "out"))


def test_obj_has_a_normal_for_every_vertex():
    normals = np.random.default_rng(9).normal(size=(300, 3)).astype(np.float32)
    text = joined(write_mesh(mesh([3, 5] * 99, normals=normals), "obj", "out")).decode().splitlines()
    found = np.array([line.split()[1:] for line in text if line.startswith("vn ")], np.float32)
    np.testing.assert_array_equal(found, normals)
    corners = [corner.split("//") for line in text if line.startswith("f ") for corner in line.split()[1:]]
    assert corners
    assert all(vertex == normal for vertex, normal in corners)


def test_polygons_of_less_than_three_corners_are_no_triangles_of_gltf():
    data = joined(write_mesh(mesh((2, 3, 1, 4)), "glb", "x"))
    assert len(open_bytes(data, "x.glb", None).coloured_vertices().faces) == 3


@pytest.mark.parametrize("form", [form for form in MESHES if form != "gltf"])  # whose buffer is another file
def test_another_reader_finds_the_same(form):
    contents = mesh((3,) * 200)
    data = joined(write_mesh(contents, form, "x"))
    other = trimesh.load(io.BytesIO(data), file_type=form, process=False, maintain_order=True)
    other = other if form != "glb" else next(iter(other.geometry.values()))
    places = contents.positions[contents.corners].reshape(-1, 3, 3)
    np.testing.assert_allclose(other.vertices[other.faces], places, atol=1e-7)
    found = open_bytes(data, f"x.{form}", None).coloured_vertices()
    np.testing.assert_allclose(found.positions[found.faces], places, atol=1e-7)
    if form != "glb":  # trimesh takes its linear 16-bit numbers for levels
        levels = np.rint(contents.colours * 255)[contents.corners].reshape(-1, 3, 3)
        np.testing.assert_array_equal(other.visual.vertex_colors[other.faces][..., :3], levels)


def test_gltf_has_bounds_of_positions_and_short_indices_and_points_have_none():
    contents = mesh((3, 3))
    tree, buffers = unpacked(joined(write_mesh(contents, "glb", "x")))
    (primitive,) = tree["meshes"][0]["primitives"]
    accessor = tree["accessors"][primitive["attributes"]["POSITION"]]
    assert accessor["min"] == contents.positions.min(axis=0).tolist()
    assert accessor["max"] == contents.positions.max(axis=0).tolist()
    assert numbers(tree, buffers, primitive["indices"]).dtype == np.uint16
    (points,) = unpacked(joined(write_mesh(mesh(()), "glb", "x")))[0]["meshes"][0]["primitives"]
    assert (points["mode"], "indices" in points) == (0, False)


def test_what_is_lost_is_said_in_one_sentence_each():
    for form in MESHES:
        *_, last = write_mesh(mesh(left_out=("materials", "skins")), form, "out").notices
        assert last == "Not converted: materials; skins."
    bright = mesh((4,), dtype=np.float64)
    bright = dataclasses.replace(bright, colours=bright.colours * 2)
    notices = " ".join(write_mesh(bright, "glb", "x").notices)
    for word in ("single precision", "cut into triangles", "clipped", "linear light"):
        assert word in notices
    assert not write_mesh(mesh((), encoding="linear"), "glb", "x").notices


def test_positions_beyond_single_precision_are_refused_by_gltf():
    with pytest.raises(InputError, match="too large"):
        write_mesh(mesh(positions=np.full((300, 3), 1e300)), "glb", "x")
