"""USD scenes: where images and colours are shown, and that nothing else changes, in layers as in packages."""

import dataclasses

import numpy as np
import pytest

from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.usd.layers import binary_layer
from beltrami_cli.jobs.bake import bake_file
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import EmbeddingSettings
from beltrami_cli.surface.records import Frame

pytest.importorskip("pxr", reason="usd-core is not installed")

from formats.usd_files import (
    BOUND,
    COLOURS,
    GIVEN,
    HEADER,
    PICTURE,
    POINTS,
    QUADS,
    coloured,
    material_text,
    mesh_text,
    rows,
    scene,
    shader,
    smoothed,
)
from hostile.folders import write

# Its own process, and what it makes of damaged files, is tested in test_usd_packages.py.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("usd_core_here")]


@pytest.mark.parametrize(("on", "kind"), [("vertex", "color3h"), ("faceVarying", "color3f")])
def test_of_a_text_only_the_colours_change(on, kind, tmp_path):
    count = 4 * len(QUADS) if on == "faceVarying" else len(POINTS)
    lines = coloured(np.resize(COLOURS, (count, 3)), kind, on)
    text = scene("    # a comment, which no program for USD keeps\n", mesh_text(lines))
    (tmp_path / "a.usda").write_text(text)
    smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN)
    old, new = ((tmp_path / name).read_text().splitlines() for name in ("a.usda", "b.usda"))
    changed = [one for one, other in zip(old, new, strict=True) if one != other]
    assert [line.split()[1] for line in changed] == ["primvars:displayColor"]
    vertices = open_document(str(tmp_path / "a.usda")).coloured_vertices()
    assert vertices.stored == {"color3f": "float32", "color3h": "float16"}[kind]
    assert vertices.encoding == "linear"
    places = POINTS.round(6)[QUADS.ravel()] if on == "faceVarying" else POINTS.round(6)
    np.testing.assert_allclose(vertices.positions, places, atol=1e-6)


def test_of_a_binary_layer_only_the_colours_change(tmp_path):
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(scene(mesh_text(coloured(COLOURS[: len(POINTS)]))))
    layer.Export(str(tmp_path / "a.usd"))
    smooth_file(tmp_path / "a.usd", tmp_path / "b.usd", GIVEN)
    old = np.frombuffer((tmp_path / "a.usd").read_bytes(), np.uint8)
    changed = np.flatnonzero(old != np.frombuffer((tmp_path / "b.usd").read_bytes(), np.uint8))
    assert 0 < changed[-1] - changed[0] < 12 * len(POINTS)
    smooth_file(tmp_path / "a.usd", tmp_path / "c.usda", GIVEN)
    one, other = (
        open_document(str(tmp_path / name)).coloured_vertices().colours for name in ("b.usd", "c.usda")
    )
    np.testing.assert_array_equal(one, other)


def test_a_unit_in_single_precision_is_read(tmp_path):
    """As exporters wrote it before usd-core refused that."""
    text = scene(mesh_text(coloured(COLOURS[: len(POINTS)]))).replace(
        "metersPerUnit = 1", "metersPerUnit = 0.625"
    )
    layer = binary_layer(text.encode(), "a.usdc")
    double, single = (b"\x20\x3f\0\0" + bytes([kind, 0x40]) for kind in (9, 8))
    assert layer.count(double) == 1
    (tmp_path / "a.usdc").write_bytes(layer.replace(double, single))
    smooth_file(tmp_path / "a.usdc", tmp_path / "b.usdc", GIVEN)
    assert check_files(tmp_path / "a.usdc", tmp_path / "b.usdc").faithful


def test_colours_of_a_palette_get_one_of_their_own_at_each_place(tmp_path):
    palette = rows(np.arange(len(POINTS)) % 7)
    (tmp_path / "a.usda").write_text(scene(mesh_text(coloured(COLOURS[:7], indices=palette))))
    before = open_document(str(tmp_path / "a.usda")).coloured_vertices().colours
    np.testing.assert_array_equal(before, COLOURS[np.arange(len(POINTS)) % 7])
    assert len(np.unique(smoothed(tmp_path).coloured_vertices().colours, axis=0)) > 7


def test_the_surface_is_that_which_is_shown(tmp_path):
    shown = coloured(COLOURS[: len(POINTS)])
    moved = (
        "        matrix4d xformOp:transform = ( (0, 2, 0, 0), (-2, 0, 0, 0), (0, 0, 2, 0), (5, 6, 7, 1) )\n"
    )
    moved += '        uniform token[] xformOpOrder = ["xformOp:transform"]\n'
    left = '        uniform token orientation = "leftHanded"\n        int[] holeIndices = [0, 3]\n'
    hidden = '        token visibility = "invisible"\n', '        uniform token purpose = "guide"\n'
    flat = '        color3f[] primvars:displayColor = [(1, 0, 0)] ( interpolation = "constant" )\n'
    bodies = [shown + moved, shown + moved + left, *(shown + line for line in hidden), flat]
    cloud = mesh_text(shown, "cloud").replace("def Mesh", "def Points")
    text = scene(*(mesh_text(body, f"mesh{number}") for number, body in enumerate(bodies)), cloud)
    (tmp_path / "a.usda").write_text(text)
    document = open_document(str(tmp_path / "a.usda"))
    found = document.coloured_vertices()
    wanted = POINTS.round(6).astype(np.float32) @ [[0, 2, 0], [-2, 0, 0], [0, 0, 2]] + [5, 6, 7]
    np.testing.assert_allclose(found.positions, np.concatenate([wanted, wanted]), atol=1e-6)
    a, b, c = found.positions[found.faces].transpose(1, 0, 2)
    upright = np.cross(b - a, c - a)[:, 2] > 0
    count = 2 * len(QUADS)
    assert upright.tolist() == [True] * count + [False] * (count - 4)
    said = " ".join(document.notices)
    assert "2 mesh(es) are invisible" in said
    assert "1 mesh(es) have one colour" in said
    assert "1 prim(s) that are not meshes have colours of points" in said


def folder_scene(folder):
    """Write a scene whose mesh and material are in layers of their own, under a payload, with a variant."""
    root = scene(
        '    def Xform "thing" (\n prepend payload = @parts/mesh.usda@\n variants = {\n string look = "two"\n }\n'
        '    prepend variantSets = "look"\n )\n    {\n        variantSet "look" = {\n'
        '            "one" { asset other = @textures/other.png@\n rel material:binding = </scan/none>\n}\n'
        '            "two" { rel material:binding = </scan/skin>\n}\n'
        "        }\n    }\n",
        material_text("textures/a.png"),
    )
    part = '#usda 1.0\n(\n defaultPrim = "thing"\n subLayers = [@../base.usda@]\n)\n'
    thing = '#usda 1.0\ndef Xform "thing" ( prepend apiSchemas = ["MaterialBindingAPI"] )\n{\n'
    base = thing + mesh_text() + "}\n"
    images = dict.fromkeys(("textures/a.png", "textures/other.png"), PICTURE)
    write(folder, {"a.usda": root, "parts/mesh.usda": part, "base.usda": base, **images})
    return folder / "a.usda"


def test_layers_beside_the_root_are_followed_and_stay(tmp_path):
    source = folder_scene(tmp_path / "in")
    document = open_document(str(source))
    others = {"base.usda", "parts/mesh.usda", "textures/other.png"}
    assert {*document.references()} == {*others, "textures/a.png"}
    (tmp_path / "out").mkdir()
    smooth_file(source, tmp_path / "out" / "b.usda", GIVEN)
    new = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*")}
    assert new == {*others, "b.usda", "textures/b.png"}
    for name in others:
        assert (tmp_path / "out" / name).read_bytes() == (source.parent / name).read_bytes()
    assert check_files(source, tmp_path / "out" / "b.usda").faithful
    before = {path: path.read_bytes() for path in source.parent.rglob("*.usda")}
    smooth_file(source, source, GIVEN, Job(overwrite=True))
    assert {path: path.read_bytes() for path in source.parent.rglob("*.usda")} == before
    assert (source.parent / "textures/a.png").read_bytes() != PICTURE
    with pytest.raises(
        InputError, match=r"another 'parts/mesh\.usda' in OUTPUT's folder, .*; choose an empty folder"
    ):
        smooth_file(source, tmp_path / "out" / "c.usda", GIVEN)


def test_colours_of_another_layer_get_a_stronger_opinion_in_the_root(tmp_path):
    mesh = mesh_text(coloured(COLOURS[: len(POINTS)]))
    look = 'variants = {\n string look = "one"\n}\n prepend variantSets = "look"'
    base = f'#usda 1.0\ndef Xform "scan" (\n{look}\n)\n{{\n variantSet "look" = {{\n "one" {{\n{mesh}}}\n}}\n}}\n'
    write(tmp_path, {"a.usda": "#usda 1.0\n( subLayers = [@./base.usda@] )\n", "base.usda": base})
    said = smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN).warnings
    assert ["Variants of another layer" in notice for notice in said] == [True]
    report = check_files(tmp_path / "a.usda", tmp_path / "b.usda")
    assert [each.of_colour for each in report.differences] == [True]


def test_instances_are_smoothed_once(tmp_path):
    twice = "".join(
        f'    def Xform "{name}" (\n instanceable = true\n prepend references = </scan/proto>\n) {{ }}\n'
        for name in "ab"
    )
    proto = '    class Xform "proto"\n    {\n' + mesh_text(coloured(COLOURS[: len(POINTS)])) + "    }\n"
    (tmp_path / "a.usda").write_text(scene(twice, proto, mesh_text(name="bare")))
    document = smoothed(tmp_path)
    assert len(document.coloured_vertices().colours) == len(POINTS)
    assert ["instances of others" in notice for notice in document.notices] == [True]
    lost = {"further places of a mesh", "uncoloured meshes", "texture coordinates"}
    assert lost <= {*document.contents().left_out}


def test_layers_outside_are_not_read(tmp_path):
    layers = "@../secret.usda@, @http://x/y.usda@, @gone.usda@, @a.png@"
    write(tmp_path, {
        "secret.usda": scene(mesh_text(coloured(COLOURS[: len(POINTS)]))),
        "in/a.usda": f"#usda 1.0\n( subLayers = [{layers}] )\n",
        "in/a.png": PICTURE,
    })  # fmt: skip
    document = open_document(str(tmp_path / "in" / "a.usda"))
    with pytest.raises(NoColoursError):
        document.coloured_vertices()
    said = " ".join(document.notices)
    for cause in ("leaves the model's folder", "is not a relative path", "is missing", "is not a USD layer"):
        assert cause in said


def test_files_that_nothing_shows_are_copied_beside_the_output(tmp_path):
    """Such as an image of roughness alone, or the surroundings that light a scene."""
    rough = shader("rough", "UsdUVTexture", "asset inputs:file = @tex/rough.png@", "float outputs:r")
    light = '    def DomeLight "light"\n    {\n        asset inputs:texture:file = @sky.png@\n    }\n'
    text = scene(mesh_text(BOUND), material_text("a.png", extra=rough), light)
    others = {"tex/rough.png": PICTURE, "sky.png": PICTURE + b" "}
    write(tmp_path / "in", {"a.usda": text, "a.png": PICTURE, **others})
    (tmp_path / "out").mkdir()
    smooth_file(tmp_path / "in" / "a.usda", tmp_path / "out" / "b.usda", GIVEN)
    assert all((tmp_path / "out" / name).read_bytes() == data for name, data in others.items())
    assert check_files(tmp_path / "in" / "a.usda", tmp_path / "out" / "b.usda").faithful


@pytest.mark.parametrize("on", ["vertex", "faceVarying"])
def test_colours_and_opacity_beside_textures_are_converted_or_said_to_be_lost(on, tmp_path):
    rows_of = np.arange(64) if on == "vertex" else QUADS.ravel()
    opacity = (rows_of / 64).round(3)
    lines = f'float[] primvars:displayOpacity = {rows(opacity)} ( interpolation = "{on}" )\n'
    text = scene(mesh_text(BOUND + coloured(COLOURS[rows_of], on=on) + lines), material_text("a.png"))
    write(tmp_path, {"a.usda": text, "a.png": PICTURE})
    mesh = open_document(str(tmp_path / "a.usda")).textured_mesh()
    if on == "vertex":
        np.testing.assert_array_equal(mesh.colours, COLOURS)
        np.testing.assert_allclose(mesh.alpha, opacity, atol=1e-6)
    else:
        assert "vertex colours, which are not one for each vertex" in mesh.left_out


@pytest.mark.parametrize("line", ["displayOpacity = [0.25]", "displayOpacity = [0.5, 1]", "weight = [0.25]"])
def test_constant_opacity_is_converted_and_what_nothing_reads_is_said_to_be_lost(line, tmp_path):
    mesh = mesh_text(BOUND + coloured(COLOURS) + f"        float[] primvars:{line}\n")
    text = (
        scene(mesh, material_text("a.png"))
        .replace("primvars:st", "primvars:map")
        .replace('= "st"', '= "map"')
    )
    write(tmp_path, {"a.usda": text, "a.png": PICTURE})
    document = open_document(str(tmp_path / "a.usda"))
    for mesh, others in (
        (document.contents(), ["materials", "texture coordinates"]),
        (document.textured_mesh(), []),
    ):
        is_known = line == "displayOpacity = [0.25]"
        assert [*mesh.left_out] == [*others, *([] if is_known else ["further vertex attributes"])]
        assert (mesh.alpha is not None and set(mesh.alpha) == {0.25}) == is_known


@pytest.mark.parametrize("form", ["usda", "usdc"])
def test_positions_are_not_smoothed_in_vain(form, tmp_path):
    write(tmp_path, {"a.usda": scene(mesh_text(coloured(COLOURS)))})
    settings = dataclasses.replace(GIVEN, embedding=EmbeddingSettings(smooth_geometry=True))
    with pytest.raises(InputError, match="positions of a usda file cannot be replaced"):
        smooth_file(tmp_path / "a.usda", tmp_path / f"b.{form}", settings)
    assert [path.name for path in tmp_path.iterdir()] == ["a.usda"]


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "inf"])
def test_units_that_are_no_lengths_count_as_metres(unit, tmp_path):
    header = HEADER.replace("metersPerUnit = 1", f"metersPerUnit = {unit}").replace('"Y"', '"X"')
    write(tmp_path, {"a.usda": scene(mesh_text(coloured(COLOURS)), header=header)})
    assert open_document(str(tmp_path / "a.usda")).frame == Frame()


@pytest.mark.parametrize(
    ("lines", "unwrap"),
    [
        ((coloured(COLOURS),), BakeSettings()),
        ((BOUND, material_text("a.png")), None),
        ((BOUND, material_text("a.png")), "vertices"),
    ],
)
def test_the_axis_and_the_unit_of_a_scene_are_kept_in_gltf(lines, unwrap, tmp_path):
    header = HEADER.replace("metersPerUnit = 1", "metersPerUnit = 0.01").replace('"Y"', '"Z"')
    write(tmp_path, {"a.usda": scene(mesh_text(lines[0]), *lines[1:], header=header), "a.png": PICTURE})
    if unwrap == "vertices":
        report = bake_file(tmp_path / "a.usda", tmp_path / "b.glb", "vertices")
    else:
        report = smooth_file(tmp_path / "a.usda", tmp_path / "b.glb", GIVEN, unwrap=unwrap)
    document = open_document(str(tmp_path / "b.glb"))
    surface = (
        document.coloured_vertices() if document.has_vertex_colours() else document.textured("baseColor")
    )
    corners = np.unique(surface.positions[surface.faces].reshape(-1, 3), axis=0)
    # What was z is up, in metres, and the handedness is the same.
    expected = np.unique(POINTS[:, [0, 2, 1]] * [0.01, 0.01, -0.01], axis=0)
    np.testing.assert_allclose(corners[np.lexsort(corners.T)], expected[np.lexsort(expected.T)], atol=1e-7)
    assert "the axis" not in str(report)
    smooth_file(tmp_path / "a.usda", tmp_path / "c.usdz", GIVEN)
    assert open_document(str(tmp_path / "c.usdz")).frame == Frame("Z", 0.01)
    said = smooth_file(tmp_path / "a.usda", tmp_path / "d.ply", GIVEN)
    assert "the axis that is up, which is Z; the unit of 0.01 m" in str(said)
