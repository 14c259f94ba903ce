"""`beltrami render`: a picture of every kind of file, the same at every run, or nothing happens at all."""

import numpy as np
import pytest

from cli.commands import SAMPLES, beltrami
from cli.pictures import coloured_square, pixels, plain_image
from formats.image_files import encode

pytest.importorskip("embreex")


def test_colours_come_out_as_they_are_shown_whatever_the_file_stores(tmp_path):
    srgb = np.array([200, 100, 30]) / 255
    light = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    ply, glb = coloured_square(tmp_path / "a.ply", srgb), coloured_square(tmp_path / "a.glb", light)
    png = plain_image(tmp_path / "a.png", [200, 100, 30])
    out = tmp_path / "out.png"
    beltrami("render", ply, glb, png, out, "--size", 50, "--no-labels")
    image = pixels(out)
    assert image.shape == (50, 154, 3)
    for left in (0, 52, 104):
        assert (image[10:40, left + 10 : left + 40] == [200, 100, 30]).all()


@pytest.mark.slow
def test_views_stand_side_by_side_with_labels_details_and_one_camera(tmp_path):
    files = [SAMPLES / f"nonmanifold-{kind}.ply" for kind in ("noisy", "clean")]
    both, one = tmp_path / "both.png", tmp_path / "one.png"
    looks = ("--size", "160x120", "--view", "three-quarter", "--lit")
    beltrami("render", *files, both, *looks, "--crop", "auto", "--crop", "0.5,0.5,0.3")
    beltrami("render", files[1], one, *looks)
    image, alone = pixels(both), pixels(one)
    assert alone.shape == (120, 160, 3)
    strip, detail, gap = round(1.8 * 11), 79, 2
    assert image.shape == (strip + 120 + gap + detail, 160 + gap + 160, 3)
    assert (image[:strip, :160] < 128).any()  # the letters
    assert (image[:strip, 162:] < 128).any()
    framed = (image[strip : strip + 120, 162:] != alone).any(axis=2)
    assert 0 < framed.mean() < 0.1  # nothing but the frames of the details
    stacked = tmp_path / "stacked.png"
    beltrami("render", *files, stacked, *looks, "--stacked", "--no-labels")
    assert (pixels(stacked)[122:] == alone).all()


def test_a_preview_of_a_wide_image_has_no_bands_above_and_below_it(tmp_path):
    wide = tmp_path / "wide.png"
    wide.write_bytes(encode(np.random.default_rng(0).integers(90, 120, (60, 240, 3), np.uint8), "png"))
    beltrami("smooth", wide, tmp_path / "out.png", "--fast", "--preview", tmp_path / "look.png")
    height, width, _ = pixels(tmp_path / "look.png").shape
    details = (width - 8) // 4  # half as wide as a view, and square
    assert height - details < 0.35 * width / 2
