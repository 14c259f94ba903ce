"""`beltrami smooth` and `beltrami info` on images, as a user calls them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltrami_cli.formats.image import read_image, to_float
from cli.commands import beltrami, refused
from formats.image_files import encode

ROWS, COLUMNS = 60, 80


@pytest.fixture
def photo(tmp_path):
    """A photo of two colours with noise of 0.06, a depth map and a mask."""
    y, x = np.mgrid[:ROWS, :COLUMNS]
    clean = np.where((x + y > 70)[..., None], [0.7, 0.4, 0.3], [0.2, 0.5, 0.6])
    noisy = clean + np.random.default_rng(1).normal(0, 0.06, clean.shape)
    (tmp_path / "photo.png").write_bytes(encode(np.rint(255 * np.clip(noisy, 0, 1)).astype(np.uint8), "png"))
    depth = np.hypot(x - 40, y - 30).astype(np.float32)[..., None]
    (tmp_path / "depth.exr").write_bytes(encode(np.where(depth < 28, depth, np.nan), "openexr", "float"))
    (tmp_path / "mask.png").write_bytes(encode((255 * (x > 10)).astype(np.uint8)[..., None], "png"))
    return tmp_path, clean


def values(path):
    return to_float(read_image(path.read_bytes(), path.name))


def test_a_photo_comes_out_cleaner_without_any_option(photo):
    folder, clean = photo
    run = beltrami("smooth", "photo.png", "clean.png", cwd=folder)
    assert b"clean.png: 80 x 60 pixels, noise" in run.stderr
    errors = [np.sqrt(np.mean((values(folder / name) - clean) ** 2)) for name in ("photo.png", "clean.png")]
    assert errors[1] < 0.3 * errors[0]


def test_images_go_through_pipes_in_their_format_or_another(photo):
    folder, _ = photo
    data = (folder / "photo.png").read_bytes()
    beltrami("smooth", "photo.png", "clean.png", "--fast", cwd=folder)
    piped = beltrami("smooth", "-", "-", "--fast", stdin=data)
    assert piped.stdout == (folder / "clean.png").read_bytes()
    other = beltrami("smooth", "-", "-", "--fast", "--format", "exr", stdin=data)
    assert read_image(other.stdout, "out.exr").format == "openexr"
    assert beltrami("smooth", "-", "-", "-n", 0, stdin=data).stdout == data


@pytest.mark.slow
def test_the_surface_and_the_mask_of_an_image_are_options(photo):
    folder, _ = photo
    for options in (["--height", "depth.exr", "--height-scale", "2"], ["--mask", "mask.png"]):
        beltrami("smooth", "photo.png", "out.png", *options, "--overwrite", "--report", "r.json", cwd=folder)
        facts = json.loads((folder / "r.json").read_text())["image"]["image"]
        assert facts["surface"] == ("height" if "--height" in options else "plane")
        kept = (values(folder / "out.png") == values(folder / "photo.png")).all(axis=2)
        assert 0 < facts["holes"] <= np.count_nonzero(kept)


def test_the_paper_preset_takes_its_scheme(photo):
    folder, _ = photo
    options = ["--preset", "paper", "--height", "depth.exr", "--report", "r.json"]
    beltrami("smooth", "photo.png", "out.png", *options, cwd=folder)
    parameters = json.loads((folder / "r.json").read_text())["parameters"]
    assert (parameters["scheme"], parameters["iterations"], parameters["window"]) == ("metric", 1, 7)
    assert parameters["image"]["height"] == "depth.exr"


def test_an_image_has_nothing_to_unwrap(photo):
    refused(photo[0], "smooth", "photo.png", "out.png", "--unwrap", code=3, said="photo.png: it is an image")


@pytest.mark.slow
def test_info_shows_what_an_image_is(photo):
    folder, _ = photo
    shown = beltrami("info", "photo.png", "-v", "--height", "depth.exr", cwd=folder)
    for word in ("png", "80", "60", "R, G, B", "uint8", "height", "noise", "beta"):
        assert word in shown.stdout.decode()
    facts = json.loads(beltrami("info", "photo.png", "--json", cwd=folder).stdout)
    assert facts["noise"]["red"] == pytest.approx(0.06, rel=0.1)
