"""Textures of PLY files: coordinates of vertices and of faces, and that only images and their names change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.records import ImageFile
from formats.ply_files import ENCODINGS, Table, build

XYZ = [("x", "float"), ("y", "float"), ("z", "float")]
PLACES = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [1, 0.5, 0], [0, 2, 0]]


def opened(folder, tables, encoding="ascii", newline="\n", *names):
    comments = ["made by a test", *(f"TextureFile {name}" for name in names or ("a b.png",)), "last"]
    (folder / "model.ply").write_bytes(build(tables, encoding, newline, comments).data)
    for name in ("a b.png", "b.png"):
        (folder / name).write_bytes(b"image " + name.encode())
    document = open_document(str(folder / "model.ply"))
    assert isinstance(document, PlyDocument)
    return document


def pentagon(*, u="s", v="t", polygons=None):
    """A concave pentagon (or other polygons) whose coordinates are half its places."""
    rows = [[*place, place[0] / 2, place[1] / 2] for place in PLACES]
    faces = [[face] for face in polygons or [[0, 1, 2, 3, 4]]]
    return [
        Table("vertex", [*XYZ, (u, "float"), (v, "float")], rows),
        Table("face", [("vertex_indices", "uchar int")], faces),
    ]


def wedges(polygons, numbers=None, bare=()):
    """The same with coordinates of faces, and a number of the texture."""
    rows: list[list[float | list[float]]] = []
    for row, face in enumerate(polygons):
        flat = [] if row in bare else [PLACES[i][axis] / 2 for i in face for axis in (0, 1)]
        rows.append([list(face), flat, *([numbers[row]] if numbers else [])])
    properties = [("vertex_indices", "uchar int"), ("texcoord", "uchar float")]
    return [
        Table("vertex", XYZ, [list(place) for place in PLACES]),
        Table("face", [*properties, *([("texnumber", "int")] if numbers else [])], rows),
    ]


def assert_half_the_places(document, chosen=slice(None)):
    surface = document.textured("baseColor")
    plane = surface.positions[surface.faces][chosen, :, :2] / 2
    np.testing.assert_allclose(surface.uv[chosen, :, 0], plane[..., 0], atol=1e-6)
    np.testing.assert_allclose(1 - surface.uv[chosen, :, 1], plane[..., 1], atol=1e-6)


@pytest.mark.parametrize(
    ("encoding", "u", "v"),
    [
        ("ascii", "s", "t"),
        (ENCODINGS[1], "u", "v"),
        (ENCODINGS[2], "texture_u", "texture_v"),
        ("ascii", "texture_s", "texture_t"),
    ],
)
def test_coordinates_of_vertices_with_v_turned_down(tmp_path, encoding, u, v):
    document = opened(tmp_path, pentagon(u=u, v=v), encoding)
    assert not document.has_vertex_colours()
    assert document.slots() == ("baseColor",)
    surface = document.textured("baseColor")
    assert document.textured("baseColor") is surface
    assert_half_the_places(document)
    assert surface.texture_of.tolist() == [0, 0, 0]
    assert [(t.key, t.name, t.data) for t in surface.textures] == [("a b.png", "a b.png", b"image a b.png")]
    assert list(document.references()) == ["a b.png"]
    with pytest.raises(InputError, match="no normal texture"):
        document.textured("normal")


@pytest.mark.parametrize(
    ("encoding", "newline", "kind"),
    [
        ("ascii", "\n", "int"),
        ("ascii", "\r\n", "float"),
        (ENCODINGS[1], "\r\n", "char"),
        (ENCODINGS[2], "\n", "float"),
    ],
)
def test_coordinates_of_faces_are_cut_along_with_polygons(tmp_path, encoding, newline, kind):
    polygons = [[0, 1, 2, 3, 4], [0, 1, 2], [4, 3, 0], [0, 1, 2, 4]]
    tables = wedges(polygons, [1, 0, -1, 1], bare=(1,))
    tables[1].properties[-1] = ("texnumber", kind)
    surface = opened(tmp_path, tables, encoding, newline, "b.png", "a b.png").textured("baseColor")
    names = [surface.textures[i].name if i >= 0 else "" for i in surface.texture_of]
    assert names == ["a b.png"] * 3 + ["", ""] + ["a b.png"] * 2
    textured = surface.texture_of >= 0
    plane = surface.positions[surface.faces][textured][..., :2] / 2
    turned = np.stack([plane[..., 0], 1 - plane[..., 1]], axis=2)
    np.testing.assert_allclose(surface.uv[textured], turned, atol=1e-6)


def test_coordinates_of_faces_go_before_those_of_vertices(tmp_path):
    tables = wedges([[0, 1, 2]])
    tables[0] = Table("vertex", [*XYZ, ("s", "float"), ("t", "float")], [[*place, 9, 9] for place in PLACES])
    assert_half_the_places(opened(tmp_path, tables))


def test_several_images_are_one_if_they_are_the_same_and_shown_as_far_as_they_are_there(tmp_path):
    document = opened(tmp_path, wedges([[0, 1, 2]]), "ascii", "\n", "b.png", "a b.png")
    assert document.textured("baseColor").texture_of.tolist() == [0]
    assert any("2 textures" in notice for notice in document.notices)
    two = wedges([[0, 1, 2], [0, 2, 4]], [0, 1])
    surface = opened(tmp_path, two, "ascii", "\n", "b.png", "./b.png").textured("baseColor")
    assert (len(surface.textures), surface.texture_of.tolist()) == (1, [0, 0])
    document = opened(tmp_path, two, "ascii", "\n", "gone.png", "b.png")
    assert document.textured("baseColor").texture_of.tolist() == [-1, 0]
    assert any("'gone.png'" in notice for notice in document.notices)


def test_files_without_images_or_coordinates_have_no_slot(tmp_path):
    data = build(pentagon()).data
    assert PlyDocument(data, "x.ply").slots() == ()
    bare = opened(tmp_path, [Table("vertex", XYZ, [[0, 0, 0]])])
    assert bare.slots() == ()
    with pytest.raises(InputError, match="no texture coordinates"):
        bare.textured("baseColor")


@pytest.mark.parametrize(
    ("rows", "cause"),
    [([[[0, 1, 2], [0.0] * 4, 0]], "4 numbers"), ([[[0, 1, 2], [0.0] * 6, 3]], "texture 3"),
     ([[[0, 1, 2], [0.0] * 5 + [float("inf")], 0]], "not finite")],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_damaged_coordinates_are_refused(tmp_path, rows, cause, encoding):
    tables = wedges([[0, 1, 2]], [0])
    tables[1].rows[:] = rows
    with pytest.raises(InputError, match=cause):
        opened(tmp_path, tables, encoding).textured("baseColor")


@given(st.sampled_from(ENCODINGS), st.sampled_from(["\n", "\r\n"]), st.booleans(), st.booleans(), st.data())
@settings(max_examples=40, deadline=None)
def test_only_the_name_changes_and_colours_beside_it(tmp_path_factory, encoding, newline, moved, paint, data):
    folder = tmp_path_factory.mktemp("p")
    colour = data.draw(st.integers(0, 255))
    tables = pentagon()
    tables[0].properties.extend([("red", "uchar"), ("green", "uchar"), ("blue", "uchar")])
    for row in tables[0].rows:
        row.extend([colour, 7, 9])
    document = opened(folder, tables, encoding, newline, "a b.png", "b.png", "a b.png")
    source = (folder / "model.ply").read_bytes()
    colours = document.painted().colours.copy()
    if paint:
        colours[:, 0] = (255 - colour) / 255
        for row in tables[0].rows:
            row[5] = 255 - colour
    suffix = data.draw(st.sampled_from([".png", ".exr"]))
    image = ImageFile(b"new", suffix)
    written = document.patch(colours, Naming("out", keeps=moved), images={("baseColor", "a b.png"): image})
    name = ("a b" if moved else "out_a b") + suffix
    comments = ["made by a test", f"TextureFile {name}", "TextureFile b.png", f"TextureFile {name}", "last"]
    assert b"".join(bytes(piece) for piece in written.main) == build(tables, encoding, newline, comments).data
    assert dict(written.sidecars) == {name: b"new"}
    assert (folder / "model.ply").read_bytes() == source
    assert (folder / "a b.png").read_bytes() == b"image a b.png"
