"""USD scenes: what is shown where, and that only colours and images change, in layers as in packages."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from beltrami_cli.errors import InputError, UnpaintedError, UsageError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.usd.package import Package
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.surface.lookup import look_up
from cli.commands import beltrami

pytest.importorskip("pxr", reason="usd-core is not installed")

from formats.image_files import encode
from formats.tile_files import TILES, obj_text, painting, sheet
from formats.usd_files import (
    BOUND,
    COLOURS,
    GIVEN,
    coloured,
    material_text,
    members,
    mesh_text,
    package,
    phone_scan,
    rows,
    scene,
    write,
)

pytestmark = pytest.mark.slow
PICTURE = encode(painting(), "png")
POINTS, _, QUADS = sheet()


def pixels(data: bytes):
    return read_image(data, "image").pixels.astype(np.int64)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return phone_scan(tmp_path_factory.mktemp("scan"))


@pytest.fixture(scope="module")
def smoothed(scan):
    smooth_file(scan, scan.with_name("new.usdz"), GIVEN)
    return scan.with_name("new.usdz")


def test_a_scan_keeps_its_layers_and_gets_new_images_in_their_place(scan, smoothed):
    before, after = members(scan), members(smoothed)
    assert list(before) == list(after) == ["baked.usdc", "0/baked_tex0.png"]
    assert before["baked.usdc"] == after["baked.usdc"]
    assert np.abs(pixels(after["0/baked_tex0.png"]) - painting()).mean() > 3
    report = check_files(scan, smoothed)
    assert (report.faithful, len(report.differences)) == (True, 1)
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(smoothed))
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/scan/mesh")).GetPointsAttr().Get()) == len(POINTS)


def test_a_scan_is_smoothed_as_the_same_mesh_in_another_format(smoothed, tmp_path):
    (tmp_path / "a.obj").write_text(obj_text(sheet()[1].round(6) / 2, POINTS.round(6), QUADS))
    (tmp_path / "model.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    (tmp_path / "skin.png").write_bytes(PICTURE)
    smooth_file(tmp_path / "a.obj", tmp_path / "b.obj", GIVEN)
    other = pixels(members(smoothed)["0/baked_tex0.png"])
    assert np.abs(pixels((tmp_path / "b_skin.png").read_bytes()) - other).max() <= 1


def test_a_package_goes_through_a_pipe(scan, tmp_path):
    done = beltrami("smooth", "-", "-", "-n", "1", "--beta", "20", stdin=scan.read_bytes())
    assert done.returncode == 0
    (tmp_path / "piped.usdz").write_bytes(done.stdout)
    before, after = members(scan), members(tmp_path / "piped.usdz")
    assert [name for name in before if before[name] != after[name]] == ["0/baked_tex0.png"]


def test_nothing_new_is_the_same_file(scan):
    document = open_document(str(scan))
    assert b"".join(document.patch(None, Naming("new")).main) == scan.read_bytes()
    assert document.references() == []


def test_tiles_in_a_package_are_one_surface(smoothed, tmp_path):
    smooth_file(phone_scan(tmp_path / "in", udim=True), tmp_path / "new.usdz", GIVEN)
    before, after = members(tmp_path / "in" / "scan.usdz"), members(tmp_path / "new.usdz")
    assert list(before) == list(after)
    assert before["baked.usdc"] == after["baked.usdc"]
    whole = pixels(members(smoothed)["0/baked_tex0.png"])
    side = len(whole) // 2
    for u, v in TILES:
        tile = pixels(after[f"0/baked_tex0.{1001 + u + 10 * v}.png"])
        wanted = whole[(1 - v) * side : (2 - v) * side, u * side : (u + 1) * side]
        assert np.abs(tile - wanted).max() <= 1
    assert len(check_files(tmp_path / "in" / "scan.usdz", tmp_path / "new.usdz").differences) == 4


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
    painted = open_document(str(tmp_path / "a.usda")).painted()
    assert painted.stored == {"color3f": "float32", "color3h": "float16"}[kind]
    assert painted.encoding == "linear"
    places = POINTS.round(6)[QUADS.ravel()] if on == "faceVarying" else POINTS.round(6)
    np.testing.assert_allclose(painted.positions, places, atol=1e-6)


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
    one, other = (open_document(str(tmp_path / name)).painted().colours for name in ("b.usd", "c.usda"))
    np.testing.assert_array_equal(one, other)


def test_colours_of_a_palette_get_one_of_their_own_at_each_place(tmp_path):
    palette = rows(np.arange(len(POINTS)) % 7)
    (tmp_path / "a.usda").write_text(scene(mesh_text(coloured(COLOURS[:7], indices=palette))))
    before = open_document(str(tmp_path / "a.usda")).painted().colours
    np.testing.assert_array_equal(before, COLOURS[np.arange(len(POINTS)) % 7])
    smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN)
    after = open_document(str(tmp_path / "b.usda")).painted().colours
    assert len(np.unique(after, axis=0)) > 7
    assert check_files(tmp_path / "a.usda", tmp_path / "b.usda").faithful


def test_the_surface_is_that_which_is_shown(tmp_path):
    moved = (
        "        matrix4d xformOp:transform = ( (0, 2, 0, 0), (-2, 0, 0, 0), (0, 0, 2, 0), (5, 6, 7, 1) )\n"
    )
    moved += '        uniform token[] xformOpOrder = ["xformOp:transform"]\n'
    extra = coloured(COLOURS[: len(POINTS)]) + moved
    left = extra + '        uniform token orientation = "leftHanded"\n        int[] holeIndices = [0, 3]\n'
    hidden = coloured(COLOURS[: len(POINTS)]) + '        token visibility = "invisible"\n'
    guide = coloured(COLOURS[: len(POINTS)]) + '        uniform token purpose = "guide"\n'
    flat = '        color3f[] primvars:displayColor = [(1, 0, 0)] ( interpolation = "constant" )\n'
    text = scene(
        mesh_text(extra),
        mesh_text(left, "l"),
        mesh_text(hidden, "h"),
        mesh_text(guide, "g"),
        mesh_text(flat, "f"),
    )
    (tmp_path / "a.usda").write_text(text)
    document = open_document(str(tmp_path / "a.usda"))
    painted = document.painted()
    wanted = POINTS.round(6).astype(np.float32) @ [[0, 2, 0], [-2, 0, 0], [0, 0, 2]] + [5, 6, 7]
    np.testing.assert_allclose(painted.positions, np.concatenate([wanted, wanted]), atol=1e-6)
    areas = np.cross(
        *(painted.positions[painted.faces[:, k]] - painted.positions[painted.faces[:, 0]] for k in (1, 2))
    )
    count = 2 * len(QUADS)
    assert len(painted.faces) == 2 * count - 4
    assert (areas[:count, 2] > 0).all()
    assert (areas[count:, 2] < 0).all()
    said = " ".join(document.notices)
    assert "2 mesh(es) are invisible" in said
    assert "1 mesh(es) have one colour" in said


def test_coordinates_are_moved_and_images_wrapped_as_the_material_says(tmp_path):
    transform = """        def Shader "move"
        {
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = <%s/st.outputs:result>
            float inputs:rotation = 90
            float2 inputs:scale = (2, 3)
            float2 inputs:translation = (0.5, 0.25)
            float2 outputs:result
        }
"""
    other = '        def GeomSubset "part" (prepend apiSchemas = ["MaterialBindingAPI"])\n        {\n'
    other += '            uniform token elementType = "face"\n            uniform token familyName = "materialBind"\n'
    other += "            int[] indices = [0, 1]\n            rel material:binding = </scan/two>\n        }\n"
    text = scene(
        mesh_text(BOUND + other),
        material_text("a.png", reader="move", extra=transform % "/scan/skin"),
        material_text("b.png", "/scan/two"),
    )
    write(tmp_path, {"a.usda": text, "a.png": PICTURE, "b.png": PICTURE})
    surface = open_document(str(tmp_path / "a.usda")).textured("baseColor")
    names = np.array([texture.name for texture in surface.textures])[surface.texture_of]
    assert sorted(set(names[:4])) == ["b.png"]
    assert sorted(set(names[4:])) == ["a.png"]
    assert surface.textures[0].wrap == ("repeat", "mirror")
    st = (sheet()[1] / 2).round(6)[surface.faces]
    np.testing.assert_allclose(surface.uv[:4], np.stack([st[:4, :, 0], 1 - st[:4, :, 1]], axis=2), atol=1e-6)
    # Scaled, then turned to the left by 90 degrees, then moved.
    u, v = 0.5 - 3 * st[4:, :, 1], 0.25 + 2 * st[4:, :, 0]
    np.testing.assert_allclose(surface.uv[4:], np.stack([u, 1 - v], axis=2), atol=1e-5)


def folder_scene(folder):
    """Write a scene whose mesh and material are in layers of their own, under a payload, with a variant."""
    root = scene(
        '    def Xform "thing" (\n prepend payload = @parts/mesh.usda@\n variants = {\n string look = "two"\n }\n'
        '    prepend variantSets = "look"\n )\n    {\n        variantSet "look" = {\n'
        '            "one" { rel material:binding = </scan/none>\n}\n'
        '            "two" { rel material:binding = </scan/skin>\n}\n'
        "        }\n    }\n",
        material_text("textures/a.png"),
    )
    part = '#usda 1.0\n(\n defaultPrim = "thing"\n subLayers = [@../base.usda@]\n)\n'
    base = (
        '#usda 1.0\ndef Xform "thing" ( prepend apiSchemas = ["MaterialBindingAPI"] )\n{\n'
        + mesh_text()
        + "}\n"
    )
    write(folder, {"a.usda": root, "parts/mesh.usda": part, "base.usda": base, "textures/a.png": PICTURE})
    return folder / "a.usda"


def test_layers_beside_the_root_are_followed_and_stay(tmp_path):
    source = folder_scene(tmp_path / "in")
    document = open_document(str(source))
    assert sorted(document.references()) == ["base.usda", "parts/mesh.usda", "textures/a.png"]
    (tmp_path / "out").mkdir()
    smooth_file(source, tmp_path / "out" / "b.usda", GIVEN)
    new = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*")}
    assert new == {"b.usda", "base.usda", "parts/mesh.usda", "textures/b.png"}
    for name in ("base.usda", "parts/mesh.usda"):
        assert (tmp_path / "out" / name).read_bytes() == (source.parent / name).read_bytes()
    assert check_files(source, tmp_path / "out" / "b.usda").faithful
    before = {path: path.read_bytes() for path in source.parent.rglob("*.usda")}
    smooth_file(source, source, GIVEN, Job(overwrite=True))
    assert {path: path.read_bytes() for path in source.parent.rglob("*.usda")} == before
    assert (source.parent / "textures/a.png").read_bytes() != PICTURE
    with pytest.raises(
        InputError, match=r"another 'parts/mesh\.usda', whose name is needed.*; choose an empty folder"
    ):
        smooth_file(source, tmp_path / "out" / "c.usda", GIVEN)


def test_colours_of_another_layer_get_a_stronger_opinion_in_the_root(tmp_path):
    write(tmp_path, {
        "a.usda": '#usda 1.0\n( subLayers = [@./base.usda@] )\n',
        "base.usda": scene(mesh_text(coloured(COLOURS[: len(POINTS)]))),
    })  # fmt: skip
    smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN)
    report = check_files(tmp_path / "a.usda", tmp_path / "b.usda")
    assert [each.of_colour for each in report.differences] == [True]


def test_instances_are_smoothed_once(tmp_path):
    twice = "".join(
        f'    def Xform "{name}" (\n instanceable = true\n prepend references = </scan/proto>\n) {{ }}\n'
        for name in "ab"
    )
    proto = '    class Xform "proto"\n    {\n' + mesh_text(coloured(COLOURS[: len(POINTS)])) + "    }\n"
    (tmp_path / "a.usda").write_text(scene(twice, proto))
    smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN)
    document = open_document(str(tmp_path / "b.usda"))
    assert len(document.painted().colours) == len(POINTS)
    assert check_files(tmp_path / "a.usda", tmp_path / "b.usda").faithful
    assert any("instances of others" in notice for notice in document.notices)


def test_layers_outside_are_not_read(tmp_path):
    write(tmp_path, {
        "secret.usda": scene(mesh_text(coloured(COLOURS[: len(POINTS)]))),
        "in/a.usda": '#usda 1.0\n( subLayers = [@../secret.usda@, @%s@, @http://x/y.usda@, @gone.usda@, @a.png@] )\n'
        % (tmp_path / "secret.usda"),
        "in/a.png": PICTURE,
    })  # fmt: skip
    document = open_document(str(tmp_path / "in" / "a.usda"))
    with pytest.raises(UnpaintedError):
        document.painted()
    said = " ".join(document.notices)
    for cause in (
        "leaves the model's folder",
        "is not a relative path",
        "'gone.usda' is missing",
        "is no USD layer",
    ):
        assert cause in said
    assert "4 " not in said


MTLX = """    def Material "skin"
    {
        token outputs:mtlx:surface.connect = </scan/skin/surface.outputs:surface>
        def Shader "surface"
        {
            uniform token info:id = "ND_standard_surface_surfaceshader"
            color3f inputs:base_color.connect = </scan/skin/images.outputs:colour>
            token outputs:surface
        }
        def NodeGraph "images"
        {
            color3f outputs:colour.connect = </scan/skin/images/image.outputs:out>
            def Shader "image"
            {
                uniform token info:id = "ND_tiledimage_color3"
                asset inputs:file = @a.png@
                float2 inputs:uvtiling = (2, 1)
                float2 inputs:uvoffset = (0.25, 0)
                string inputs:vaddressmode = "mirror"
                color3f outputs:out
            }
        }
    }
"""


def test_materialx_networks_in_layers_show_their_image(tmp_path):
    write(tmp_path, {"a.usda": scene(mesh_text(BOUND), MTLX), "a.png": PICTURE})
    surface = open_document(str(tmp_path / "a.usda")).textured("baseColor")
    assert surface.textures[0].wrap == ("repeat", "mirror")
    _, uv, quads = sheet()
    plain = uv[quads.ravel()] / 2 * [2, 1] - [0.25, 0]
    assert {*map(tuple, surface.uv.reshape(-1, 2).round(4))} == {
        *map(tuple, (plain * [1, -1] + [0, 1]).round(4))
    }
    smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN)
    text = (tmp_path / "a.usda").read_text()
    assert (tmp_path / "b.usda").read_text() == text.replace("@a.png@", "@./b.png@")
    assert check_files(tmp_path / "a.usda", tmp_path / "b.usda").faithful


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("ND_tiledimage_color3", "ND_multiply_color3"), "no MaterialX surface whose colour is an image"),
        (('def Material "skin"', 'def Material "skin" ( references = @a.mtlx@ )'), "is no USD layer.*usdcat"),
        (("@a.png@", "@../a.png@"), "leaves the model's folder.*copy its files into"),
    ],
)
def test_what_is_not_read_of_materials_is_said_with_the_way_out(change, words, tmp_path):
    text = scene(mesh_text(BOUND), MTLX).replace(*change)
    if "mtlx" in change[1]:
        text = text.replace("outputs:mtlx:surface.connect", "outputs:mtlx:other.connect")
    write(tmp_path / "in", {"a.usda": text, "a.png": PICTURE})
    with pytest.raises(InputError, match=words):
        smooth_file(tmp_path / "in" / "a.usda", tmp_path / "b.usda", GIVEN)


def test_files_that_nothing_shows_are_copied_beside_the_output(tmp_path):
    """Such as an image of roughness alone, or the surroundings that light a scene."""
    rough = """        def Shader "rough"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @tex/rough.png@
            float outputs:r
        }
"""
    light = '    def DomeLight "light"\n    {\n        asset inputs:texture:file = @sky.png@\n    }\n'
    text = scene(mesh_text(BOUND), material_text("a.png", extra=rough), light)
    others = {"tex/rough.png": PICTURE, "sky.png": PICTURE + b" "}
    write(tmp_path / "in", {"a.usda": text, "a.png": PICTURE, **others})
    (tmp_path / "out").mkdir()
    smooth_file(tmp_path / "in" / "a.usda", tmp_path / "out" / "b.usda", GIVEN)
    assert all((tmp_path / "out" / name).read_bytes() == data for name, data in others.items())
    assert check_files(tmp_path / "in" / "a.usda", tmp_path / "out" / "b.usda").faithful


@pytest.mark.parametrize("image", ["../secret.png", "gone.png"])
def test_images_that_cannot_be_read_are_named(image, tmp_path):
    write(tmp_path, {"secret.png": PICTURE, "in/a.usda": scene(mesh_text(BOUND), material_text(image))})
    with pytest.raises(InputError) as caught:
        smooth_file(tmp_path / "in" / "a.usda", tmp_path / "b.usda", GIVEN)
    assert image.rpartition("/")[2] in str(caught.value)


@pytest.mark.parametrize("suffix", ["usdz", "usda"])
def test_glb_and_usd_are_converted_into_each_other(scan, suffix, tmp_path):
    smooth_file(scan, tmp_path / "by.glb", GIVEN, iterations=0)
    smooth_file(tmp_path / "by.glb", tmp_path / f"new.{suffix}", GIVEN, iterations=0)
    old, new = (open_document(str(path)).textured("baseColor") for path in (scan, tmp_path / f"new.{suffix}"))
    assert old.textures[0].data == new.textures[0].data
    assert old.textures[0].wrap == new.textures[0].wrap
    np.testing.assert_allclose(new.positions[new.faces], old.positions[old.faces], atol=1e-6)
    np.testing.assert_allclose(new.uv, old.uv, atol=1e-6)
    if suffix == "usdz":
        assert next(iter(members(tmp_path / "new.usdz"))) == "new.usdc"


@pytest.mark.parametrize("suffix", ["usdz"])
def test_vertex_colours_become_linear_light_and_come_back(suffix, tmp_path):
    lines = "".join(
        f"v {x} {y} 0 {r} {g} {b}\n"
        for x, y, r, g, b in [(0, 0, 1, 0, 0.2), (1, 0, 0, 1, 0), (0, 1, 0.5, 0.5, 1)]
    )
    (tmp_path / "a.obj").write_text(lines + "f 1 2 3\n")
    smooth_file(tmp_path / "a.obj", tmp_path / f"b.{suffix}", GIVEN, iterations=0)
    smooth_file(tmp_path / f"b.{suffix}", tmp_path / "c.obj", GIVEN, iterations=0)
    one, other = (open_document(str(tmp_path / name)).painted() for name in ("a.obj", "c.obj"))
    np.testing.assert_allclose(other.colours, one.colours, atol=1e-5)
    np.testing.assert_array_equal(other.faces, one.faces)


def test_converted_images_lie_where_they_did(scan, tmp_path):
    smooth_file(scan, tmp_path / "new.obj", GIVEN, iterations=0)
    surface = open_document(str(tmp_path / "new.obj")).textured("baseColor")
    picture = read_image(surface.textures[0].data, "a").pixels / 255
    middles = surface.positions[surface.faces].mean(axis=1)[:, :2] * [0.5, -0.5] + [0, 1]
    shown = look_up(picture, surface.uv.mean(axis=1), ("repeat", "repeat"))
    np.testing.assert_allclose(shown, look_up(painting() / 255, middles, ("repeat", "repeat")), atol=1e-3)


def damaged(scan, kind):
    layers = dict(members(scan))
    root = layers["baked.usdc"]
    random = np.random.default_rng(1)
    return {
        "cut off": [("baked.usdc", root[: len(root) // 2])],
        "noise": [("a.usdc", root[:100] + random.bytes(len(root) - 100))],
        "no text": [("a.usda", b"#usda 1.0\ndef Mesh {{{")],
        "no layer first": [("a.png", PICTURE), ("a.usdc", root)],
        "way out": [("a.usdc", root), ("../a.png", PICTURE)],
        "absolute": [("a.usdc", root), ("/a.png", PICTURE)],
    }[kind]


@pytest.mark.parametrize("kind", ["cut off", "noise", "no text", "no layer first", "way out", "absolute"])
def test_damaged_packages_are_refused_in_one_line(scan, kind, tmp_path):
    source = package(tmp_path / "a.usdz", damaged(scan, kind))
    done = beltrami("smooth", source, tmp_path / "b.usdz")
    assert done.returncode == 3
    assert done.stderr.decode().count("\n") == 1
    assert not (tmp_path / "b.usdz").exists()


def test_packages_that_readers_cannot_map_are_found_by_check_and_written_right(scan, tmp_path):
    files = [*members(scan).items()]
    bad = package(tmp_path / "bad.usdz", files, zipfile.ZIP_DEFLATED)
    shifted = package(tmp_path / "shifted.usdz", [*files, ("notes.txt", b"x")])
    compressed, moved = (Package(path.read_bytes(), "a", Access()).faults() for path in (bad, shifted))
    assert compressed == [f"{name} is compressed" for name, _ in files]
    assert "notes.txt is of a type that no package may hold" in moved
    report = check_files(scan, shifted)
    assert not report.faithful
    assert any("64 bytes" in each.detail for each in report.differences)
    smooth_file(bad, tmp_path / "good.usdz", GIVEN)
    assert not Package((tmp_path / "good.usdz").read_bytes(), "a", Access()).faults()
    from pxr import Sdf, Usd, UsdUtils

    archive = (Sdf if hasattr(Sdf, "ZipFile") else Usd).ZipFile.Open(str(tmp_path / "good.usdz"))
    assert archive.GetFileNames() == list(dict(files))
    for each in map(archive.GetFileInfo, archive.GetFileNames()):
        assert (each.dataOffset % 64, each.compressionMethod, each.encrypted) == (0, 0, False)
    unresolved = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(tmp_path / "good.usdz")))[2]
    assert not unresolved


def test_packages_get_no_images_that_they_may_not_hold(scan, tmp_path):
    with pytest.raises(UsageError, match=r"packages hold no \.webp images"):
        smooth_file(scan, tmp_path / "a.usdz", GIVEN, image_suffix=".webp")


def test_bombs_are_not_unpacked(tmp_path):
    source = package(tmp_path / "a.usdz", [("a.usda", b"#usda 1.0\n" + bytes(1 << 27))], zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match="more than any model has"):
        open_document(str(source))


def test_without_usd_core_the_way_to_install_it_is_said(scan, tmp_path):
    (tmp_path / "pxr").mkdir()
    (tmp_path / "pxr" / "__init__.py").write_text("raise ImportError(name='pxr')\n")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-P", "-m", "beltrami_cli", "info", str(scan)],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, check=False, text=True,
    )  # fmt: skip
    assert done.returncode == 3
    assert "pip install 'beltrami-cli[usd]'" in done.stderr


def test_an_image_that_is_shown_twice_is_named_once_in_the_root(tmp_path):
    glowing = material_text("a.png").replace(
        "            float inputs:roughness",
        "            color3f inputs:emissiveColor.connect = </scan/skin/diffuse.outputs:rgb>\n"
        "            float inputs:roughness",
    )
    base = scene(mesh_text(BOUND), glowing)
    write(
        tmp_path,
        {"a.usda": "#usda 1.0\n( subLayers = [@./base.usda@] )\n", "base.usda": base, "a.png": PICTURE},
    )
    smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN, slots=("baseColor", "emissive"))
    assert (tmp_path / "b.usda").read_text().count("@./b.png@") == 1
    assert check_files(tmp_path / "a.usda", tmp_path / "b.usda").faithful


def test_an_image_that_is_shown_as_something_else_too_stays_in_the_package(tmp_path):
    other = """        def Shader "other"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @a.png@
            float2 inputs:st.connect = </scan/skin/st.outputs:result>
            float outputs:r
        }
"""
    text = scene(mesh_text(BOUND), material_text("a.png", extra=other)).replace(
        "float inputs:roughness = 1", "float inputs:roughness.connect = </scan/skin/other.outputs:r>"
    )
    source = package(tmp_path / "a.usdz", [("a.usda", text.encode()), ("a.png", PICTURE)])
    smooth_file(source, tmp_path / "b.usdz", GIVEN)
    after = members(tmp_path / "b.usdz")
    assert list(after) == ["a.usda", "a.png", "b.png"]
    assert after["a.png"] == PICTURE
    assert after["a.usda"].decode().count("@./b.png@") == 1
    assert check_files(source, tmp_path / "b.usdz").faithful
