"""USD packages: only images change in them, and what they were converted from comes back; none does harm."""

import os
import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.usd.layers import binary_layer
from beltrami_cli.formats.usd.package import Package
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from cli.commands import beltrami, refused

pytest.importorskip("pxr", reason="usd-core is not installed")

from formats.gltf_files import joined
from formats.image_files import encode
from formats.tile_files import TILES, phantom
from formats.usd_files import (
    BOUND,
    COLOURS,
    GIVEN,
    HEADER,
    PICTURE,
    POINTS,
    coloured,
    material_text,
    members,
    mesh_text,
    package,
    phone_scan,
    scene,
    shader,
)

pytestmark = pytest.mark.slow


def pixels(data):
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
    assert np.abs(pixels(after["0/baked_tex0.png"]) - phantom()).mean() > 3
    report = check_files(scan, smoothed)
    assert (report.faithful, len(report.differences)) == (True, 1)
    document = open_document(str(scan))
    assert joined(document.patch(None, Naming("new"))) == scan.read_bytes()
    assert document.references() == []
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(smoothed))
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/scan/mesh")).GetPointsAttr().Get()) == len(POINTS)


def test_a_package_goes_through_a_pipe(scan, tmp_path):
    done = beltrami("smooth", "-", "-", "-n", "1", "--beta", "20", stdin=scan.read_bytes())
    (tmp_path / "piped.usdz").write_bytes(done.stdout)
    before, after = members(scan), members(tmp_path / "piped.usdz")
    assert [name for name in before if before[name] != after[name]] == ["0/baked_tex0.png"]


@pytest.mark.usefixtures("usd_core_here")
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


@pytest.mark.usefixtures("usd_core_here")
def test_layers_that_are_named_as_tiles_are_left_alone_in_a_package(tmp_path):
    """Such a name was asked for again and again."""
    text = scene(mesh_text(coloured(COLOURS))).replace("(\n", "(\n    subLayers = [@b.<UDIM>.usda@]\n", 1)
    files = [("a.usda", text.encode()), ("b.1001.usda", HEADER.encode())]
    document = open_document(str(package(tmp_path / "a.usdz", files)))
    assert document.has_vertex_colours()
    assert document.notices == ("'b.<UDIM>.usda' is not in the package, and is left alone.",)


@pytest.mark.usefixtures("usd_core_here")
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


@pytest.mark.usefixtures("usd_core_here")
def test_vertex_colours_become_linear_light_and_come_back(tmp_path):
    lines = ["v 0 0 0 1 0 0.2 0.5", "v 1 0 0 0 1 0 1", "v 0 1 0 0.5 0.5 1 0.25", "f 1 2 3", ""]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    smooth_file(tmp_path / "a.obj", tmp_path / "opacity.usda", GIVEN, iterations=0)
    (opacity,) = re.findall(r"displayOpacity = \[(.*?)\]", (tmp_path / "opacity.usda").read_text())
    np.testing.assert_allclose([*map(float, opacity.split(","))], [0.5, 1, 0.25])
    smooth_file(tmp_path / "a.obj", tmp_path / "b.usdz", GIVEN, iterations=0)
    smooth_file(tmp_path / "b.usdz", tmp_path / "c.obj", GIVEN, iterations=0)
    one, other = (open_document(str(tmp_path / name)).coloured_vertices() for name in ("a.obj", "c.obj"))
    np.testing.assert_allclose(other.colours, one.colours, atol=1e-5)
    np.testing.assert_array_equal(other.faces, one.faces)


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


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("cut off", r"\(UsdError: [\w ]+ corrupt"), ("no text", r"\(UsdError: a.usda:2:"), ("noise", ""),
        ("no layer first", ""), ("way out", ""), ("absolute", ""),
    ],
)  # fmt: skip
def test_damaged_packages_are_refused_in_one_line_without_names_of_code(scan, kind, words, tmp_path):
    """Neither functions and sources of usd-core, nor the folder that the layers lie in for a while."""
    source = package(tmp_path / "a.usdz", damaged(scan, kind))
    line = refused(tmp_path, "smooth", source, tmp_path / "b.usdz", code=3)
    assert re.search(words, line)
    assert "pxr" not in line
    assert "/beltrami-" not in line


@pytest.mark.usefixtures("usd_core_here")
def test_text_that_is_damaged_is_kept_and_compared(tmp_path):
    """A note that is not UTF-8: `smooth` keeps it, and `check` sees where it was not kept."""
    note = '        string note = "a wall in Koeln"\n'
    text = scene(mesh_text(BOUND + note), material_text("a.png"))
    layer = binary_layer(text.encode(), "a.usdc")
    assert layer.count(b"Koeln") == 1
    for folder, damage in (("in", b"K\xf6eln"), ("out", b""), ("other", b"K\xe4eln")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.usdc").write_bytes(layer.replace(b"Koeln", damage or b"Koeln"))
        (tmp_path / folder / "a.png").write_bytes(encode(phantom(), "png"))
    source, target, other = (tmp_path / folder / "a.usdc" for folder in ("in", "out", "other"))
    smooth_file(source, target, GIVEN, Job(overwrite=True))
    assert target.read_bytes() == source.read_bytes()
    assert check_files(source, target).faithful
    assert not check_files(other, target).faithful


def test_a_package_that_begins_with_something_else_is_no_archive_to_unpack(tmp_path):
    with zipfile.ZipFile(tmp_path / "scan.usdz", "w") as file:
        file.writestr("readme.txt", "a scan")
    with pytest.raises(InputError, match="its first file is not a USD layer"):
        open_document(str(tmp_path / "scan.usdz"))


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


@pytest.mark.usefixtures("usd_core_here")
def test_an_image_that_is_shown_as_something_else_too_stays_in_the_package(tmp_path):
    placed = "float2 inputs:st.connect = </scan/skin/st.outputs:result>"
    other = shader("other", "UsdUVTexture", "asset inputs:file = @a.png@", placed, "float outputs:r")
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


@pytest.mark.usefixtures("usd_core_here")
def test_an_image_that_is_damaged_is_left_alone_next_to_sound_ones(tmp_path):
    lost = BOUND.replace("skin", "lost")
    text = scene(
        mesh_text(BOUND),
        mesh_text(lost, "other"),
        material_text("a.png"),
        material_text("b.png", "/scan/lost"),
    )
    other = encode(np.zeros((8, 8, 3), np.uint8), "png")
    source = package(tmp_path / "a.usdz", [("a.usda", text.encode()), ("a.png", PICTURE), ("b.png", other)])
    data = source.read_bytes()
    source.write_bytes(data.replace(other, other[:-1] + b"?"))
    document = open_document(str(source))
    surface = document.textured("baseColor")
    (texture,) = surface.textures
    assert texture.data == PICTURE
    assert any("'b.png' b.png in the archive is damaged" in notice for notice in surface.notices)


@pytest.mark.usefixtures("usd_core_here")
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


@pytest.mark.usefixtures("usd_core_here")
def test_packages_get_no_images_that_they_may_not_hold(scan, tmp_path):
    with pytest.raises(UsageError, match=r"packages hold no \.webp images"):
        smooth_file(scan, tmp_path / "a.usdz", GIVEN, image_suffix=".webp")
