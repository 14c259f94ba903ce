"""Formats that are read only: their colours come out as PLY or glTF, and damage is refused."""

import io
import re
import struct
import zipfile
from importlib.util import find_spec

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError, NoColoursError, UsageError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.meshes.coloured_polygons import ColouredPolygons, colours_of_vertices
from beltrami_cli.formats.registry import open_bytes
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.surface.colour_values import linear_to_srgb
from formats.read_only_files import FACES, LEVELS, OBJECT, SQUARE, VERTICES, coff, model, opened, stl, threemf


@pytest.mark.parametrize(
    ("style", "prefix", "extra"),
    [("float", "C", ""), ("integer", "", ""), ("float", "CN", "0 0 1"), ("integer", "c", "")],
)
def test_off_with_colours_of_vertices(style, prefix, extra):
    data = coff(style, prefix, extra)
    # Counts may stand right behind the mark.
    for text in (data, data.replace(b"OFF\n# a comment\n4 2 0", b"OFF 4 2 0")):
        vertices = opened(text, "x.off").coloured_vertices()
        np.testing.assert_array_equal(vertices.positions, SQUARE)
        np.testing.assert_allclose(vertices.colours, LEVELS / 255, atol=1e-7)
        assert vertices.faces.tolist() == FACES


@pytest.mark.parametrize("alpha", ["", " 255"])
def test_off_with_colours_of_faces_gives_vertices_their_mean(alpha):
    places = "\n".join(" ".join(map(str, place)) for place in [*SQUARE.tolist(), [0.0, 3.0, 0.0]])
    lines = f"3 0 1 2 255 0 0{alpha}\n3 0 2 3 0 255 0{alpha}\n3 3 2 4 0 0 255{alpha}"
    document = opened(f"OFF 5 3 0\n{places}\n{lines}\n".encode(), "x.off")
    colours = document.coloured_vertices().colours
    # The areas are 1/2, 1/2 and 1.
    expected = [[0.5, 0.5, 0], [1, 0, 0], [0.25, 0.25, 0.5], [0, 1 / 3, 2 / 3], [0, 0, 1]]
    np.testing.assert_allclose(colours, expected, atol=1e-5)
    np.testing.assert_array_equal(colours[[1, 4]], [[1, 0, 0], [0, 0, 1]])
    assert any("3 of 5" in notice for notice in document.coloured_vertices().notices)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"OFFSET 3 1 0", "no known format"), (b"OFF BINARY\n", "only text of three dimensions"),
        (b"4OFF\n1 0 0\n1 2 3 4\n", "only text of three dimensions"), (b"OFF\n", "does not count"),
        (b"OFF\nx y z\n", "does not count"),
        (b"OFF\n3 1 0\n0 0 0\n", "it announces 3 vertices and 1 faces, but has 1 lines"),
        (b"OFF\n99999999999999999999 1 0\n0 0 0\n", "it announces"),
        (b"COFF\n2 0 0\n0 0 0 1 0 0 1\n0 0 0\n", "vertex 1 has 3 numbers, not 7"),
        (b"COFF\n1 1 0\n0 0 x 1 0 0 1\n3 0 0 0\n", "line 3: 'x' is not a number"),
        (b"COFF\n1 1 0\n0 0 nan 1 0 0 1\n3 0 0 0\n", "position of vertex 0 is not finite"),
        (b"COFF\n1 1 0\n0 0 0 nan 0 0 1\n3 0 0 0\n", "the colour of row 0 is not finite"),
        (b"COFF\n1 1 0\n0 0 0 1 0 0 1\n3 0 0\n", "face 0 does not name the vertices"),
        (b"COFF\n1 1 0\n0 0 0 1 0 0 1\n3 0 0 1\n", "names a vertex beyond the 1 of the file"),
        (b"COFF\n1 1 0\n0 0 0 1 0 0 1\n3 0 0 -1\n", "names a vertex beyond the 1 of the file"),
        (b"COFF\n1 1 0\n0 0 0 1 0 0 1\n3 0 0 99999999999999999999\n", "a vertex that cannot be"),
        (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "none of its polygons or vertices has a colour"),
        (b"OFF\n0 0 0\n", "there are no polygons"),
    ],
)  # fmt: skip
def test_damaged_off_files_are_refused(data, message):
    with pytest.raises(InputError, match=re.escape(message)):
        opened(data, "x.off").coloured_vertices()


def test_stl_colours_of_both_dialects():
    # VisCAM: blue is lowest, the highest bit marks a colour.
    vertices = opened(stl([31 << 10 | 1 << 15, 31 << 5 | 1 << 15]), "x.stl").coloured_vertices()
    assert len(vertices.positions) == 4  # of six, those at one place being one
    for place, colour in zip(vertices.positions.tolist(), vertices.colours.tolist(), strict=True):
        expected = {1.0: [0.5, 0.5, 0], 0.5: None}.get(place[0] == place[1]) or (
            [1, 0, 0] if place[0] else [0, 1, 0]
        )
        np.testing.assert_allclose(colour, expected, atol=1e-6)
    magics = opened(
        stl([31, 1 << 15], b"a COLOR=\x00\xff\x00\xff"), "x.stl"
    ).coloured_vertices()  # red is lowest
    alone = {tuple(p): c for p, c in zip(magics.positions.tolist(), magics.colours.tolist(), strict=True)}
    assert alone[1, 0, 0] == [1, 0, 0]
    assert alone[0, 1, 0] == [0, 1, 0]  # the colour of the whole


def test_stl_without_colours_or_damaged_is_refused():
    with pytest.raises(NoColoursError, match="none of its polygons"):
        opened(stl([0, 0]), "x.stl").coloured_vertices()
    with pytest.raises(NoColoursError, match="in text has no colours"):
        opened(b"solid x\nendsolid\n", "x.stl").coloured_vertices()
    with pytest.raises(InputError, match="no known format"):
        open_bytes(stl([0, 0])[:-1], "x.stl", None)
    bad = bytearray(stl([1 << 15, 1 << 15]))
    bad[84 + 12 : 84 + 16] = struct.pack("<f", np.nan)
    with pytest.raises(InputError, match="is not finite"):
        opened(bytes(bad), "x.stl").coloured_vertices()


@pytest.mark.parametrize("suffix", ["ply", "glb", "obj"])
def test_they_are_smoothed_and_written_as_another_format_with_a_line_that_says_so(suffix, tmp_path):
    grid = np.stack(np.meshgrid(range(8), range(8), indexing="ij"), axis=2).reshape(-1, 2)
    levels = np.random.default_rng(0).integers(0, 256, (64, 3))
    lines = [
        f"{x} {y} 0 {r} {g} {b} 255" for (x, y), (r, g, b) in zip(grid.tolist(), levels.tolist(), strict=True)
    ]
    lines += [f"4 {i} {i + 1} {i + 9} {i + 8}" for i in range(55) if i % 8 != 7]
    (tmp_path / "in.off").write_text(f"COFF\n64 49 0\n{chr(10).join(lines)}\n")
    report = smooth_file(tmp_path / "in.off", tmp_path / f"out.{suffix}")
    assert any("OFF files are read, but not written" in warning for warning in report.warnings)
    mesh = trimesh.load_mesh(tmp_path / f"out.{suffix}", process=False)
    assert len(mesh.vertices) == 64
    assert len(mesh.faces) == 98
    again = open_bytes((tmp_path / f"out.{suffix}").read_bytes(), f"x.{suffix}", None).coloured_vertices()
    smoothed = linear_to_srgb(again.colours) if again.encoding == "linear" else again.colours
    assert smoothed.std() < (levels / 255).std()
    with pytest.raises(InputError, match="name an output in"):
        opened((tmp_path / "in.off").read_bytes(), "x.off").patch(None, Naming("out", in_place=True))
    for name, words in {"x.vrm": "a .off file is not converted", "x.png": "end the name in .ply"}.items():
        with pytest.raises(UsageError, match=words):
            smooth_file(tmp_path / "in.off", tmp_path / name)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_vertices_have_the_mean_of_their_corners_and_nothing_beyond(data):
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    sizes = random.integers(3, 6, 10)
    corners = random.integers(0, 12, sizes.sum())
    colours = random.random((len(corners), 3), np.float32)
    colours[random.random(len(corners)) < 0.2] = np.nan
    offsets = np.append(0, np.cumsum(sizes))
    found = ColouredPolygons(random.random((12, 3)), corners, offsets, colours, "float32")
    result, _ = colours_of_vertices(found)
    for vertex in range(12):
        own = colours[(corners == vertex) & np.isfinite(colours[:, 0])]
        if not len(own):
            assert (result[vertex] == 1).all()
        else:
            assert (result[vertex] >= own.min(axis=0) - 1e-6).all()
            assert (result[vertex] <= own.max(axis=0) + 1e-6).all()


@pytest.mark.parametrize("relations", ["_rels/.rels", "_rels/none"])  # else the usual name counts
def test_3mf_colours_of_corners(relations):
    data = threemf(model(OBJECT)).replace(b"_rels/.rels", relations.encode().ljust(11))
    vertices = opened(data, "x.3mf").coloured_vertices()
    with pytest.raises(InputError, match=r"bytes, more than the .* that are read; raise --max-memory"):
        opened(data, "x.3mf", 100).coloured_vertices()
    np.testing.assert_array_equal(vertices.positions, SQUARE)
    np.testing.assert_array_equal(vertices.faces, FACES)
    np.testing.assert_allclose(vertices.colours, LEVELS / 255, atol=1e-7)
    assert vertices.stored == "uint8"


def test_3mf_materials_parts_transforms_and_other_files():
    flat = (
        '<basematerials id="5"><base name="a" displaycolor="#FF0000"/><base name="b" displaycolor="#00FF0080"/>'
        "</basematerials>"
        f'<object id="2" pid="5" pindex="1"><mesh><vertices>{VERTICES}</vertices><triangles>'
        '<triangle v1="0" v2="1" v3="2"/></triangles></mesh></object>'
    )
    parts = (
        f'{OBJECT}<object id="3"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 0 0 5"/>'
        '<component objectid="2" p:path="/3D/b.model"/></components></object>'
    )
    build = '<item objectid="3" transform="2 0 0 0 2 0 0 0 2 0 0 1"/>'
    document = opened(threemf(model(parts, build), b=model(flat)), "x.3mf")
    contents = document.contents()
    np.testing.assert_array_equal(contents.positions[:4], SQUARE * 2 + [0, 0, 11])
    np.testing.assert_array_equal(contents.positions[4:], SQUARE * 2 + [0, 0, 1])
    np.testing.assert_array_equal(contents.colours[4:7], [[0, 1, 0]] * 3)
    assert contents.alpha is not None
    np.testing.assert_allclose(contents.alpha, [1, 1, 1, 1, 128 / 255, 128 / 255, 128 / 255, 1], atol=1e-6)
    data = threemf(model(OBJECT, '<item objectid="1" transform="2 0 0 0 2 0 0 0 2 0 3 1"/>'))
    mesh = trimesh.load_scene(io.BytesIO(data), file_type="3mf").to_mesh()
    ours = opened(data, "x.3mf").coloured_vertices()
    np.testing.assert_allclose(mesh.vertices[mesh.faces], ours.positions[ours.faces])


def doubling(depth):
    parts = ""
    for number in range(2, depth):
        part = f'<component objectid="{number - 1}"/>'
        parts += f'<object id="{number}"><components>{part}{part}</components></object>'
    return model(OBJECT + parts, f'<item objectid="{depth - 1}"/>')


TEXTURED = f'<texture2dgroup id="9" texid="8"/>{OBJECT}'.replace('pid="', 'pid="9')
LAUGHS = '<!DOCTYPE model [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]>' + model(OBJECT)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK\x03\x04 junk", "the archive is damaged"),
        (threemf("no xml"), "is not XML"),
        (threemf(LAUGHS), "a document type, "),
        (threemf(model(OBJECT.replace('v1="0"', 'v1="zero"'))), "is damaged (invalid literal"),
        (threemf(model(OBJECT.replace('v1="0"', ""))), "is damaged ('v1')"),
        (threemf(model(OBJECT.replace('v3="2"', 'v3="4"'))), "beyond the 4 of its object"),
        (threemf(model(OBJECT.replace('x="1.0"', 'x="inf"'))), "is not finite"),
        (threemf(model(OBJECT.replace("#FF0000", "#F00"))), "is not a colour"),
        (threemf(model(OBJECT, '<item objectid="7"/>')), "there is no object '7'"),
        (threemf(model(OBJECT, '<item objectid="1" transform="1 2"/>')), "a transform has 2 numbers"),
        (threemf(doubling(31)), "too many parts within parts"),
        (threemf(model(OBJECT, "")), "there are no polygons"),
        (threemf(model(TEXTURED)), "its colours are textures, which are not read in files"),
    ],
)
def test_damaged_3mf_files_are_refused(data, message):
    with pytest.raises(InputError) as caught:
        opened(data, "x.3mf", 1 << 30).coloured_vertices()
    assert message in str(caught.value)


needs_collada = pytest.mark.skipif(find_spec("collada") is None, reason="pycollada is not installed")


def source(key, values, axes):
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in axes)
    accessor = f'<accessor source="#{key}a" count="4" stride="3">{params}</accessor>'
    array = f'<float_array id="{key}a" count="12">{values}</float_array>'
    return f'<source id="{key}">{array}<technique_common>{accessor}</technique_common></source>'


DAE = "\n".join(
    [
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">',
        '<asset><unit meter="1"/><up_axis>Y_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>',
        source("p", "0 0 0 1 0 0 1 1 0 0 1 0", "XYZ"),
        source("c", "1 0 0 0 0.5 0 0 0 0.25 0.1 0.2 0.3", "RGB"),
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="2">',
        '<input semantic="VERTEX" source="#v" offset="0"/><input semantic="COLOR" source="#c" offset="1"/>',
        "<p>0 0 1 1 2 2 0 0 2 2 3 3</p></triangles></mesh></geometry></library_geometries>",
        '<library_visual_scenes><visual_scene id="s"><node><translate>0 0 7</translate>',
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>',
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>',
    ]
)


IMAGE = '<library_images><image id="i"><init_from>a.png</init_from></image></library_images>'


@needs_collada
@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!DOCTYPE COLLADA []>" + DAE, "document type"),
        (DAE[:-1], "it is damaged"),
        (DAE.replace("1 1 0 0 1 0<", "1,1 0 0 1 0<"), "it is damaged, or not understood"),
        (
            DAE.replace("<library_geometries>", f"{IMAGE}<library_geometries>")
            .replace('<input semantic="COLOR" source="#c" offset="1"/>', "")
            .replace("0 0 1 1 2 2 0 0 2 2 3 3", "0 1 2 0 2 3"),
            "its colours are textures, which are not read in files",
        ),
    ],
)
def test_damaged_and_textured_dae_files_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        opened(text.encode(), "x.dae").coloured_vertices()


MATERIAL = "".join(
    [
        '<library_effects><effect id="e"><profile_COMMON><technique sid="t"><lambert><diffuse>',
        "<color>1 1 1 1</color></diffuse></lambert></technique></profile_COMMON></effect></library_effects>",
        '<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>',
    ]
)
BOUND = (
    '<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="s" target="#m"/>'
    "</technique_common></bind_material></instance_geometry>"
)


SKIN = "\n".join(
    [
        '<library_controllers><controller id="k"><skin source="#g">',
        "<bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 3 0 0 0 1</bind_shape_matrix>",
        '<source id="j"><Name_array id="ja" count="1">Bone</Name_array><technique_common>',
        '<accessor source="#ja" count="1"><param name="JOINT" type="name"/></accessor></technique_common></source>',
        '<source id="b"><float_array id="ba" count="16">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</float_array>',
        '<technique_common><accessor source="#ba" count="1" stride="16">',
        '<param name="TRANSFORM" type="float4x4"/></accessor></technique_common></source>',
        '<source id="w"><float_array id="wa" count="1">1</float_array><technique_common>',
        '<accessor source="#wa" count="1"><param name="WEIGHT" type="float"/></accessor></technique_common></source>',
        '<joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#b"/></joints>',
        '<vertex_weights count="4"><input semantic="JOINT" source="#j" offset="0"/>',
        '<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1 1 1 1</vcount>',
        "<v>0 0 0 0 0 0 0 0</v></vertex_weights>",
        "</skin></controller></library_controllers>",
    ]
)
PLACED = '<instance_geometry url="#g"/>'
COMPANIONS = {
    "": DAE,
    "materials": DAE.replace("<library_geometries>", f"{MATERIAL}<library_geometries>")
    .replace('<triangles count="2">', '<triangles count="2" material="s">')
    .replace(PLACED, BOUND),
    "skins": DAE.replace(PLACED, '<instance_controller url="#k"/>').replace(
        "<library_visual_scenes>", f"{SKIN}<library_visual_scenes>"
    ),
    "what could not be read": DAE.replace(
        "</visual_scene>", '<node><instance_geometry url="#gone"/></node></visual_scene>'
    ),
}


@needs_collada
@pytest.mark.slow
@pytest.mark.parametrize("left_out", COMPANIONS)
@pytest.mark.parametrize("suffix", ["dae", "zae"])
def test_dae_colours_are_read_in_their_place_and_precision_whatever_is_beside_them(left_out, suffix):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("model.dae", COMPANIONS[left_out])
    data = packed.getvalue() if suffix == "zae" else COMPANIONS[left_out].encode()
    document = opened(data, f"x.{suffix}")
    vertices = document.coloured_vertices()
    # Polygons with a skin are where they were bound.
    places = SQUARE[FACES] + [0, 0, 3 if left_out == "skins" else 7]
    np.testing.assert_array_equal(vertices.positions[vertices.faces], places)
    levels = np.float32([[1, 0, 0], [0, 0.5, 0], [0, 0, 0.25], [0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(vertices.colours[vertices.faces], levels[FACES])
    assert {left_out} - {""} <= {*document.contents().left_out}


@needs_collada
@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "unit", "order", "signs"),
    [("Y", 0.5, [0, 1, 2], [1, 1, 1]), ("X", 1, [1, 0, 2], [-1, 1, 1]), ("Z", 0.01, [0, 2, 1], [1, 1, -1])],
)
def test_gltf_is_in_metres_and_y_is_up_as_the_file_says(axis, unit, order, signs, tmp_path):
    (tmp_path / "in.dae").write_text(DAE.replace('"1"/><up', f'"{unit}"/><up').replace("Y_UP", f"{axis}_UP"))
    (tmp_path / "in.3mf").write_bytes(threemf(model(OBJECT).replace("<model", '<model unit="inch"')))
    frames = {
        "dae": (np.add(SQUARE, [0, 0, 7]), order, signs, unit),
        "3mf": (SQUARE, [0, 2, 1], [1, 1, -1], 0.0254),
    }
    for suffix, (places, *turn, size) in frames.items():
        smooth_file(tmp_path / f"in.{suffix}", tmp_path / f"{suffix}.glb", iterations=0)
        found = trimesh.load(tmp_path / f"{suffix}.glb", force="mesh").vertices
        wanted = np.asarray(places)[:, turn[0]] * turn[1] * size
        np.testing.assert_allclose(sorted(found.tolist()), sorted(wanted.tolist()), atol=1e-6)
