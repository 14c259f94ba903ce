"""Textures in tiles (UDIM): one manifold in several files, written as the files that they were."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.ndimage import gaussian_filter

from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import parameters_from
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError
from beltrami_cli.formats.sidecars.tile_names import found_tiles, tile_name
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.lookups import look_up
from formats.image_files import encode, saved
from formats.tile_files import GIVEN, SIDE, TILES, obj_text, part, phantom, sheet, tiled_model

REPEAT = ("repeat", "repeat")
PATTERNS = ["skin.<UDIM>.png", "skin_<udim>.png", "<UVTILE>.skin.png", "skin<uvtile>.png"]


def pixels(path):
    return read_image(path.read_bytes(), path.name).pixels.astype(np.int64)


def assembled(folder, pattern):
    """Return the tiles of a folder as one image."""
    whole = np.zeros((2 * SIDE, 2 * SIDE, 3), np.int64)
    for tile in TILES:
        part(whole, tile)[:] = pixels(folder / tile_name(pattern, tile))
    return whole


# The last tile of row 899 would be number 10000, and numbers have four digits.
@given(st.sampled_from(PATTERNS), st.integers(0, 9), st.integers(0, 898))
def test_a_name_made_for_a_tile_is_read_as_that_tile(pattern, u, v):
    name = tile_name(pattern, (u, v))
    assert found_tiles(pattern, [name]) == {(u, v): name}


def test_numbers_are_those_of_mari_mudbox_and_zbrush():
    assert [tile_name(pattern, (2, 1)) for pattern in PATTERNS] == [
        "skin.1013.png", "skin_1013.png", "u3_v2.skin.png", "skinu2_v1.png",
    ]  # fmt: skip


@pytest.mark.parametrize("label", ["1000", "0999", "10010", "100", "1o01", "", "u1_v1", "１００１"])
def test_other_names_are_of_no_tile(label):
    assert found_tiles("a.<UDIM>.png", [f"a.{label}.png", "a.png", "a..png"]) == {}
    assert found_tiles("a.<UVTILE>.png", ["a.u0_v1.png", "a.u11_v1.png", "a.1001.png"]) == {}


def test_the_tiles_of_a_set_do_not_depend_on_earlier_questions(tmp_path):
    names = ["skin.1001.png", "skin.1012.png"]
    for name in (*names, "skin.png"):
        (tmp_path / name).touch()
    folder = ModelFolder(tmp_path)
    assert folder.tiles_of("skin.<UDIM>.png") == dict(zip([(0, 0), (1, 1)], names, strict=True))
    assert folder.files(folder.locate_any("skin.<UDIM>.png")) == names
    assert folder.tiles_of("skin.png") == folder.tiles_of(None) == folder.tiles_of("other.<UDIM>.png") == {}
    assert folder.files("skin.png") == ["skin.png"]


def test_a_token_in_the_name_of_a_folder_makes_no_tile_set(tmp_path):
    (tmp_path / "<UDIM>").mkdir()
    (tmp_path / "<UDIM>" / "skin.png").touch()
    with pytest.raises(UnfitReferenceError, match="is missing"):
        ModelFolder(tmp_path).locate_any("<UDIM>/skin.png")


@pytest.mark.parametrize("pattern", PATTERNS[::2])
def test_tiles_are_smoothed_as_one_image_would_be(pattern, tmp_path):
    """Also across borders, which triangles cross: only the order of sums may differ."""
    model = tiled_model(tmp_path / "in", pattern)
    *lines, last = model.read_text().splitlines()
    model.write_text("\n".join([*lines, "usemtl other", last]))  # two materials that show the same tiles
    model.with_suffix(".mtl").write_text(
        "".join(f"newmtl {m}\nmap_Kd {pattern}\n" for m in ("skin", "other"))
    )
    smooth_file(model, tmp_path / "new.obj", GIVEN)
    positions, uv, quads = sheet()
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "model.obj").write_text(obj_text(uv / 2, positions, quads))
    (tmp_path / "one" / "model.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    (tmp_path / "one" / "skin.png").write_bytes(encode(phantom(), "png"))
    smooth_file(tmp_path / "one" / "model.obj", tmp_path / "one" / "new.obj", GIVEN)
    difference = np.abs(assembled(tmp_path, f"new_{pattern}") - pixels(tmp_path / "one" / "new_skin.png"))
    assert difference.max() <= 1
    assert np.count_nonzero(difference) <= 10
    assert np.abs(assembled(tmp_path, f"new_{pattern}") - phantom()).mean() > 3


def test_nothing_but_the_images_changes(tmp_path):
    model = tiled_model(tmp_path / "in")
    smooth_file(model, tmp_path / "new.obj", GIVEN)
    report = check_files(model, tmp_path / "new.obj")
    assert report.faithful
    assert len(report.differences) == len(TILES)
    old = (tmp_path / "in" / "model.mtl").read_text()
    assert (tmp_path / "new.mtl").read_text() == old.replace("skin.<", "new_skin.<")
    assert sorted(open_document(str(tmp_path / "new.obj")).references()) == sorted(
        path.name for path in tmp_path.iterdir() if path.suffix in (".mtl", ".png")
    )
    smooth_file(model, model, GIVEN, Job(overwrite=True))  # in its own place under its own names
    assert sorted(path.name for path in model.parent.iterdir()) == sorted(
        ["model.obj", "model.mtl", *(tile_name("skin.<UDIM>.png", tile) for tile in TILES)]
    )
    assert (assembled(model.parent, "skin.<UDIM>.png") == assembled(tmp_path, "new_skin.<UDIM>.png")).all()


def test_tiles_that_are_not_chosen_come_along(tmp_path):
    model = tiled_model(tmp_path)
    new = tmp_path / "new.obj"
    smooth_file(model, new, GIVEN, names=("skin.1002.png",))
    assert [each.what[-6:] for each in check_files(model, new).differences] == ["(1, 0)"]
    assert (tmp_path / "new_skin.1011.png").read_bytes() == (tmp_path / "skin.1011.png").read_bytes()
    smooth_file(model, tmp_path / "jpg.obj", GIVEN, image_suffix=".jpg")
    assert "jpg_skin.<UDIM>.jpg" in (tmp_path / "jpg.mtl").read_text()
    assert len(open_document(str(tmp_path / "jpg.obj")).textured("baseColor").textures) == len(TILES)


def test_a_tile_that_is_missing_is_a_hole(tmp_path):
    model = tiled_model(tmp_path / "in")
    (model.parent / "skin.1012.png").unlink()
    smooth_file(model, tmp_path / "new.obj", GIVEN)
    assert check_files(model, tmp_path / "new.obj").faithful
    assert {path.name[-8:-4] for path in tmp_path.glob("*.png")} == {"1001", "1002", "1011"}
    surface = open_document(str(tmp_path / "new.obj")).textured("baseColor")
    beyond = (surface.positions[surface.faces][..., :2].mean(axis=1) > 1).all(axis=1)
    np.testing.assert_array_equal(surface.texture_of == -1, beyond)


def test_tiles_may_differ_in_size_and_depth(tmp_path):
    model = tiled_model(tmp_path)
    small = encode(part(phantom("uint16"), (1, 0))[::2, ::2], "png")
    (tmp_path / "skin.1002.png").write_bytes(small)
    (entry,) = inspect_file(model, GIVEN)["textures"]
    found = [(image["width"], image["stored"]) for image in entry["images"]]
    assert found == [(SIDE, "uint8"), (SIDE // 2, "uint16"), (SIDE, "uint8"), (SIDE, "uint8")]
    assert entry["seams_between_textures"] == 4
    smooth_file(model, tmp_path / "new.obj", GIVEN)
    picture = read_image((tmp_path / "new_skin.1002.png").read_bytes(), "new")
    assert (picture.stored, picture.pixels.shape) == ("uint16", (SIDE // 2, SIDE // 2, 3))


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_converted_tiles_show_the_same_colours(suffix, tmp_path):
    if suffix == "obj":
        smooth_file(tiled_model(tmp_path), tmp_path / "by.glb", GIVEN, iterations=0)
        smooth_file(tmp_path / "by.glb", tmp_path / "new.obj", GIVEN, iterations=0)
    else:
        smooth_file(tiled_model(tmp_path), tmp_path / f"new.{suffix}", GIVEN, iterations=0)
    surface = open_document(str(tmp_path / f"new.{suffix}")).textured("baseColor")
    images = [read_image(texture.data, texture.name).pixels / 255 for texture in surface.textures]
    assert len(images) == len(TILES)
    middles = surface.positions[surface.faces].mean(axis=1)[:, :2]
    inside = np.flatnonzero((np.abs(surface.uv.mean(axis=1) - 0.5) < 0.4).all(axis=1))
    for face in inside:
        shown = look_up(images[surface.texture_of[face]], surface.uv[face].mean(axis=0)[None], REPEAT)
        wanted = look_up(phantom() / 255, middles[face][None] * [0.5, -0.5] + [0, 1], REPEAT)
        np.testing.assert_allclose(shown, wanted, atol=1e-3)


@pytest.mark.slow
def test_triangles_over_millions_of_tiles_are_refused(tmp_path):
    model = tiled_model(tmp_path)
    text = model.read_text()
    far = "vt -5 0\nvt 15 0\nvt 5 900\n" + "f -1/-1 -2/-2 -3/-3\n" * 2000
    model.write_text(text + far)
    with pytest.raises(
        InputError, match=r"repeat their texture more often .*; check its texture coordinates"
    ):
        open_document(str(model)).textured("baseColor")


@pytest.mark.slow
def test_tiles_that_are_jpeg_pictures_hang_together(tmp_path):
    """Within a picture neighbours share the noise of colours, but not over the border of two pictures."""
    side, random = 512, np.random.default_rng(4)
    texture = [gaussian_filter(random.standard_normal((2 * side, 2 * side)), 6) for _ in range(3)]
    clean = 0.5 + 0.15 * np.stack(texture, axis=2) / np.std(texture)
    noisy = clean + random.normal(0, 0.06, clean.shape)
    image = (noisy.clip(0, 1) * 255).astype(np.uint8)
    for tile in (0, 1):
        picture = Image.fromarray(image[:, tile * side : (tile + 1) * side])
        (tmp_path / f"skin.{1001 + tile}.jpg").write_bytes(saved(picture, ".jpg", quality=90))
    corners = np.array([(u, v) for v in (0.0, 1.0) for u in (0.0, 1.0, 2.0)])
    text = obj_text(corners, np.column_stack([corners, np.zeros(6)]), np.array([[0, 1, 4, 3], [1, 2, 5, 4]]))
    (tmp_path / "model.obj").write_text(text)
    (tmp_path / "model.mtl").write_text("newmtl skin\nmap_Kd skin.<UDIM>.jpg\n")
    fast = SmoothSettings(parameters_from({}, fast=True))
    report = smooth_file(str(tmp_path / "model.obj"), str(tmp_path / "clean.obj"), fast)
    counts = report.textures[0].counts
    assert (counts["seams"], counts["jumps"]) == (1, 0)
