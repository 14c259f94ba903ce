"""Patching a PLY file changes colours, images and their names and no other byte, whatever else the file holds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.records import ImageFile
from formats.gltf_files import patched
from formats.ply_files import CODES, ENCODINGS, Table, build, coloured

FAMILIES = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
    ("gray",),
    ("grey",),
)
COLOUR_TYPES = ("uchar", "uint8", "ushort", "uint16", "float", "float32", "double", "float64")
FULL = {"B": 255, "H": 65535}


def value(draw, kind):
    if " " in kind:
        return [value(draw, kind.split()[1]) for _ in range(draw(st.integers(0, 4)))]
    if CODES[kind] in "fd":
        return draw(st.floats(-100, 100, width=32))
    limits = np.iinfo(CODES[kind])
    return draw(st.integers(limits.min, limits.max))


@st.composite
def files(draw):
    """A random file, its colour properties, their type, and the colours with full scale 1."""
    names, kind = draw(st.sampled_from(FAMILIES)), draw(st.sampled_from(COLOUR_TYPES))
    full = FULL.get(CODES[kind], 1)
    extras = st.sampled_from([*CODES, "uchar int", "int float", "ushort double"])
    properties = [
        *((name, draw(st.sampled_from(["float", "double", "int", "uchar"]))) for name in "xyz"),
        *((name, kind) for name in names),
        *((f"extra{i}", known) for i, known in enumerate(draw(st.lists(extras, max_size=3)))),
    ]
    vertex = Table("vertex", draw(st.permutations(properties)))
    colour = st.integers(0, full) if full > 1 else st.floats(0, 1, width=32)
    colours = []
    for _ in range(draw(st.integers(1, 6))):
        given_colours = dict(zip(names, (draw(colour) for _ in names), strict=True))
        vertex.rows.append(
            [given_colours.get(n, value(draw, k) if n not in names else 0) for n, k in vertex.properties]
        )
        colours.append([given_colours[name] / full for name in names])
    index = st.integers(0, len(vertex.rows) - 1)
    count = draw(st.sampled_from(["uchar", "ushort", "int"]))
    lists = (
        draw(st.sampled_from(["vertex_indices", "vertex_index"])),
        f"{count} {draw(st.sampled_from(['uint', 'short', 'int32']))}",
    )
    face = Table("face", draw(st.permutations([lists, ("flags", "uchar"), ("uv", "uchar float")])))
    for _ in range(draw(st.integers(0, 4))):
        face.rows.append(
            [
                draw(st.lists(index, max_size=5)) if n == lists[0] else value(draw, k)
                for n, k in face.properties
            ]
        )
    other = Table("other", [("list", "int uchar"), ("scalar", "short")])
    other.rows = [[value(draw, k) for _, k in other.properties] for _ in range(draw(st.integers(0, 3)))]
    built = build(
        draw(st.permutations([vertex, face, other])),
        draw(st.sampled_from(ENCODINGS)),
        draw(st.sampled_from(["\n", "\r\n", "\r"])),
        draw(st.lists(st.sampled_from(["made by hand", "element vertex 7"]), max_size=2)),
    )
    return built, names, kind, colours


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(files(), st.data())
def test_only_changed_colour_entries_change_and_they_are_rounded_once(file, data):
    built, names, kind, colours = file
    document = PlyDocument(built.data + b"trailing bytes", "random.ply")
    assert patched(document, document.coloured_vertices().colours) == patched(document, None) == document.data
    before, full = document.coloured_vertices().colours, document.coloured_vertices().full_scale
    stored = np.array(colours) * FULL.get(CODES[kind], 1)
    np.testing.assert_array_equal(before, (stored / full).astype(np.float32))
    new = before.copy()
    rows = data.draw(
        st.lists(st.tuples(st.integers(0, len(new) - 1), st.integers(0, len(names) - 1)), max_size=5)
    )
    for row, channel in rows:
        new[row, channel] = data.draw(st.floats(0, 1, width=32))
    after = patched(document, new).removesuffix(b"trailing bytes")
    changed = [("vertex", row, names[channel]) for row, channel in np.argwhere(new != before)]
    longest = 14 if CODES[kind] == "f" else 24  # nine or 17 digits, a point and an exponent
    assert built.is_same_but_at(changed, after, longest)
    again = PlyDocument(after, "again.ply").coloured_vertices()
    # The new numbers may fit into fewer bits.
    expected = np.rint(new.astype(np.float64) * full) / again.full_scale if full > 1 else new
    np.testing.assert_array_equal(again.colours, np.asarray(expected).astype(np.float32))
    np.testing.assert_array_equal(again.faces, document.coloured_vertices().faces)


def test_text_keeps_spacing_tokens_and_line_ends():
    data = (
        b"ply\r\nformat ascii 1.0\r\ncomment  two  blanks \r\nobj_info 3\r\nelement vertex 2\r\n"
        b"property float x\r\nproperty float y\r\nproperty float z\r\nproperty uchar blue\r\n"
        b"property uchar green\r\nproperty uchar red\r\nend_header\r\n"
        b"  1.500\t2e0  3   007  8 9 \r\n4 5 6\r\n 1 2 3\r\n\r\n"
    )
    document = PlyDocument(data, "spaced.ply")
    colours = document.coloured_vertices().colours.copy()
    assert np.rint(colours * 255).tolist() == [[9, 8, 7], [3, 2, 1]]
    colours[0, 1] = 200 / 255
    colours[1, 0] = 1
    assert patched(document, colours) == data.replace(b"007  8 9", b"007  200 9").replace(
        b" 1 2 3", b" 1 2 255"
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_integers_are_clipped_to_their_range_and_alpha_is_kept(encoding):
    tables = coloured()
    tables[0].properties.insert(3, ("alpha", "uchar"))
    for number, row in enumerate(tables[0].rows):
        row.insert(3, number)
    built = build(tables, encoding)
    document = PlyDocument(built.data, "x.ply")
    again = PlyDocument(patched(document, [[-1, 0.5, 2]] * 4), "y.ply")
    assert np.rint(again.coloured_vertices().colours * 255).tolist() == [[0, 128, 255]] * 4
    assert np.rint(again.contents().alpha * 255).tolist() == [0, 1, 2, 3]


def test_float_colours_of_0_to_255_keep_their_scale_with_a_notice():
    document = PlyDocument(build(coloured(colour="float", value=51.0), "binary_little_endian").data, "x.ply")
    colours = document.coloured_vertices().colours
    np.testing.assert_allclose(colours, 0.2)
    assert "0..255" in document.coloured_vertices().notices[0]
    again = PlyDocument(patched(document, colours * 2), "y.ply")
    np.testing.assert_allclose(again.coloured_vertices().colours, 0.4)
    assert "0..255" in again.coloured_vertices().notices[0]


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


def pentagon():
    """A concave pentagon whose coordinates are half its places."""
    rows = [[*place, place[0] / 2, place[1] / 2] for place in PLACES]
    face = Table("face", [("vertex_indices", "uchar int")], [[[0, 1, 2, 3, 4]]])
    return [Table("vertex", [*XYZ, ("s", "float"), ("t", "float")], rows), face]


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


@pytest.mark.parametrize(
    ("encoding", "newline", "kind"),
    [
        ("ascii", "\n", "int"), ("ascii", "\r\n", "float"), (ENCODINGS[1], "\r\n", "char"),
        (ENCODINGS[2], "\n", "float"), ],
)  # fmt: skip
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
    surface = opened(tmp_path, tables).textured("baseColor")
    np.testing.assert_allclose(surface.uv[..., 0], surface.positions[surface.faces][..., 0] / 2, atol=1e-6)


def test_several_images_are_one_if_they_are_the_same_and_shown_as_far_as_they_are_there(tmp_path):
    document = opened(tmp_path, wedges([[0, 1, 2]]), "ascii", "\n", "b.png", "a b.png")
    assert document.textured("baseColor").texture_of.tolist() == [0]
    assert any("2 textures" in notice for notice in document.textured("baseColor").notices)
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
     ([[[0, 1, 2], [0.0] * 5 + [float("inf")], 0]], "no texture coordinates")],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_damaged_coordinates_are_refused(tmp_path, rows, cause, encoding):
    tables = wedges([[0, 1, 2]], [0])
    tables[1].rows[:] = rows
    with pytest.raises(InputError, match=cause):
        opened(tmp_path, tables, encoding).textured("baseColor")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_faces_whose_coordinates_are_not_finite_are_left_out_with_a_notice(tmp_path, encoding):
    tables = wedges([[0, 1, 2], [0, 1, 2]], [0, 0])
    tables[1].rows[1][1][2] = float("inf")
    document = opened(tmp_path, tables, encoding)
    surface = document.textured("baseColor")
    assert surface.texture_of.tolist() == [0, -1]
    assert any(notice.startswith("1 triangles of textured materials") for notice in surface.notices)


@given(st.sampled_from(ENCODINGS), st.sampled_from(["\n", "\r\n"]), st.booleans(), st.booleans(), st.data())
@settings(max_examples=40, deadline=None)
def test_only_the_name_changes_and_colours_beside_it(
    tmp_path_factory, encoding, newline, moved, recolours, data
):
    folder = tmp_path_factory.mktemp("p")
    colour = data.draw(st.integers(0, 255))
    tables = pentagon()
    tables[0].properties.extend([("red", "uchar"), ("green", "uchar"), ("blue", "uchar")])
    for row in tables[0].rows:
        row.extend([colour, 7, 9])
    document = opened(folder, tables, encoding, newline, "a b.png", "b.png", "a b.png")
    source = (folder / "model.ply").read_bytes()
    colours = document.coloured_vertices().colours.copy()
    if recolours:
        colours[:, 0] = (255 - colour) / 255
        for row in tables[0].rows:
            row[5] = 255 - colour
    suffix = data.draw(st.sampled_from([".png", ".exr"]))
    image = ImageFile(b"new", suffix)
    written = document.patch(colours, Naming("out", in_place=moved), images={("baseColor", "a b.png"): image})
    name = ("a b" if moved else "out_a b") + suffix
    comments = ["made by a test", f"TextureFile {name}", "TextureFile b.png", f"TextureFile {name}", "last"]
    assert b"".join(bytes(piece) for piece in written.main) == build(tables, encoding, newline, comments).data
    assert dict(written.sidecars) == {name: b"new"}
    assert (folder / "model.ply").read_bytes() == source
    assert (folder / "a b.png").read_bytes() == b"image a b.png"
