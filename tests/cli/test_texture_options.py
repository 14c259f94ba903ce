"""Every option for textures does what its help says, and sidecar files come whole or not at all."""

import json

import numpy as np
import pytest

from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.registry import open_document
from cli.commands import SAMPLES, beltrami
from formats.image_files import encode
from small_models import textured_squares

MIRRORED = SAMPLES / "mirrored-noisy.obj"
TORUS = SAMPLES / "torus-two-noisy.gltf"
TEXTURED = [
    "head-tex-noisy.glb", "head-tex-noisy.obj", "torus-two-noisy.gltf", "scan-noisy.ply", "mirrored-noisy.obj",
    "sphere-exr-noisy.obj", "tiled-noisy.glb",
]  # fmt: skip
SIDE = 64


CHART = slice(SIDE // 4, 3 * SIDE // 4)


def noise():
    """Grey noise, opaque."""
    pixels = np.random.default_rng(1).integers(88, 168, (SIDE, SIDE, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    return pixels


@pytest.fixture
def square(tmp_path):
    """Make a square whose chart is the middle of a texture."""

    def make(pixels):
        folder = tmp_path / "source"
        folder.mkdir()
        (folder / "square.png").write_bytes(encode(pixels, "png"))
        return textured_squares(folder / "square.obj", ("square.png", 0, (0.25, 0.75)))

    return make


def smooth(source, target, *arguments):
    target.parent.mkdir(exist_ok=True)
    beltrami("smooth", source, target, "--quiet", *arguments)
    return target


def images(model):
    textures = open_document(str(model)).textured("baseColor").textures
    return [read_image(texture.data, texture.name) for texture in textures]


def pixels(model):
    return images(model)[0].pixels.astype(int)


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_gutter_is_kept_or_refilled_as_far_as_asked(square, tmp_path):
    before = noise()
    source = square(before)
    changed = {}
    for gutter in ("keep", "0", "8"):
        after = pixels(smooth(source, tmp_path / gutter / "out.obj", "-n", "1", "--gutter", gutter))
        changed[gutter] = np.any(after != before, axis=2)
        assert changed[gutter][CHART, CHART].mean() > 0.9
    near = slice(CHART.start - 5, CHART.start - 3)
    beyond = CHART.start - 10
    for gutter in ("keep", "0"):
        assert not changed[gutter][near, CHART].any()
    assert changed["8"][near, CHART].mean() > 0.9
    assert not changed["8"][:beyond].any()
    assert not changed["8"][:, :beyond].any()


def kit(folder):
    """Write two models, each with its half of an atlas without a gap between them; return the atlas."""
    random = np.random.default_rng(2)
    atlas = np.full((SIDE, SIDE, 3), (200.0, 60.0, 50.0))
    atlas[:, SIDE // 2 :] = 40, 90, 200
    noisy = np.clip(np.rint(atlas + random.normal(0, 12, atlas.shape)), 0, 255).astype(np.uint8)
    (folder / "atlas.png").write_bytes(encode(noisy, "png"))
    (folder / "kit.mtl").write_text("newmtl skin\nmap_Kd atlas.png\n")
    for name, first in (("wall", 0.0), ("roof", 0.5)):
        lines = ["mtllib kit.mtl", "usemtl skin"]
        lines += [f"v {x} {y} 0\nvt {first + x / 2} {y}" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
        (folder / f"{name}.obj").write_text("\n".join([*lines, "f 1/1 2/2 3/3 4/4", ""]))
    return atlas


@pytest.mark.slow
def test_models_that_share_an_atlas_are_smoothed_in_place_one_after_the_other(tmp_path):
    truth = kit(tmp_path)
    said = ""
    for name, half in (("wall", slice(0, SIDE // 2)), ("roof", slice(SIDE // 2, SIDE))):
        before = pixels(tmp_path / f"{name}.obj")
        said = beltrami("smooth", f"{name}.obj", f"{name}.obj", "--overwrite", cwd=tmp_path, text=True).stderr
        changed = np.any(pixels(tmp_path / f"{name}.obj") != before, axis=2)
        assert changed[:, half].mean() > 0.9
        changed[:, half] = False
        assert not changed.any()
        other = {"wall": "roof", "roof": "wall"}[name]
        assert [line for line in said.splitlines() if "atlas.png" in line and f"{other}.obj" in line]
    (tmp_path / "roof.obj").unlink()
    (tmp_path / "own.obj").write_text("v 0 0 0\n# myatlas.png atlas.png2\n")  # which names another file
    said = beltrami("smooth", "wall.obj", "new.obj", "--overwrite", cwd=tmp_path, text=True).stderr
    assert "own.obj" not in said
    error = pixels(tmp_path / "wall.obj") - truth
    assert np.sqrt((error**2).mean()) < 12 / 3


def test_no_metric_steps_are_the_same_as_no_metric_scale(square, tmp_path):
    source = square(noise())
    common = ("-n", "2", "--beta", "10", "-t", "2.4", "--beta-growth", "2")
    steps = pixels(smooth(source, tmp_path / "steps" / "out.obj", *common, "--metric-steps", "0"))
    scale = pixels(smooth(source, tmp_path / "scale" / "out.obj", *common, "--metric-scale", "0"))
    default = pixels(smooth(source, tmp_path / "default" / "out.obj", *common, "--metric-steps", "1"))
    assert np.array_equal(steps, scale)
    assert not np.array_equal(steps, default)


def test_opacity_is_kept_or_smoothed_and_invisible_texels_lend_no_colour(square, tmp_path):
    before = np.full((SIDE, SIDE, 4), 100, np.uint8)
    before[..., 3] = 255
    before[:, SIDE // 2 :] = (255, 0, 0, 0)
    source = square(before)
    common = ("-n", "1", "--beta", "0")
    kept = pixels(smooth(source, tmp_path / "keep" / "out.obj", *common, "--alpha", "keep"))
    smoothed = pixels(smooth(source, tmp_path / "smooth" / "out.obj", *common, "--alpha", "smooth"))
    assert np.array_equal(kept[..., 3], before[..., 3])
    assert np.abs(kept[:, : SIDE // 2, :3] - 100).max() <= 1
    assert set(np.unique(smoothed[CHART, CHART, 3])) > {0, 255}


@pytest.mark.parametrize("arguments", [("--material", "ic*"), ("--texture", "*-icing.*")])
def test_globs_choose_textures_by_material_and_by_name(arguments, tmp_path):
    smooth(TORUS, tmp_path / TORUS.name, "-n", "1", *arguments)
    dough, icing = "torus-two-noisy-dough.png", "torus-two-noisy-icing.png"
    (icing_after,) = tmp_path.glob("*icing*.png")
    assert icing_after.read_bytes() != (SAMPLES / icing).read_bytes()
    assert (tmp_path / dough).read_bytes() == (SAMPLES / dough).read_bytes()
    refused = beltrami("smooth", TORUS, tmp_path / "none.gltf", arguments[0], "nothing*", code=2)
    assert icing in refused.stderr.decode()
    assert ("in the materials dough, icing" in refused.stderr.decode()) == (arguments[0] == "--material")


@pytest.mark.parametrize("name", ["basecolor", "Base_Color", "base-color", "diffuse", "ALBEDO", "all"])
def test_slots_have_many_names(name, tmp_path):
    report = tmp_path / "report.json"
    smooth(TORUS, tmp_path / "o.gltf", "--slots", name, "-n", 1, "--beta", 5, "--fast", "--report", report)
    assert [each["slot"] for each in json.loads(report.read_text())["textures"]] == ["baseColor"]


def test_world_units_are_those_of_the_file(square, tmp_path):
    source = square(noise())
    texel = 1 / (SIDE // 2)  # the square has the side 1, and half the texture's texels
    spacing = pixels(smooth(source, tmp_path / "spacing" / "out.obj", "-n", "1", "-t", "2", "--beta", "0"))
    options = ("-n", "1", "--beta", "0", "--units", "world", "-t", 2 * texel**2)
    world = pixels(smooth(source, tmp_path / "world" / "out.obj", *options))
    assert np.abs(world - spacing).max() <= 1


@pytest.mark.slow
def test_small_files_hold_the_same_pixels(tmp_path):
    plain = smooth(MIRRORED, tmp_path / "plain" / "out.obj", "-n", "1")
    small = smooth(MIRRORED, tmp_path / "small" / "out.obj", "-n", "1", "--small")
    assert np.array_equal(pixels(plain), pixels(small))
    (large_file,), (small_file,) = plain.parent.glob("*.png"), small.parent.glob("*.png")
    assert small_file.stat().st_size < large_file.stat().st_size


@pytest.mark.parametrize("target", ["out.obj", "out.ply"])
def test_another_image_format_is_written_without_iterations(target, tmp_path):
    """In the same format and in another: no pixel is changed, and the line names the change."""
    out = tmp_path / target
    run = beltrami("smooth", MIRRORED, out, "-n", "0", "--texture-format", "tif")
    assert run.stderr.splitlines()[-1].endswith(b"only the type of images is changed")
    assert [image.format for image in images(out)] == ["tiff"]
    assert np.array_equal(pixels(out), pixels(MIRRORED))


COLOURED = [path.name for path in sorted(SAMPLES.glob("nonmanifold-noisy.*"))]
IMAGES = ["scan-noisy.jpg", "mirrored-noisy.png"]


@pytest.mark.parametrize("name", [*TEXTURED, *COLOURED, *IMAGES])
def test_no_iterations_carry_every_file_byte_by_byte_to_another_folder(name, tmp_path):
    smooth(SAMPLES / name, tmp_path / name, "-n", "0")
    written = files(tmp_path)
    assert name in written
    assert written == {each: (SAMPLES / each).read_bytes() for each in written}
    assert name not in TEXTURED or images(tmp_path / name)
