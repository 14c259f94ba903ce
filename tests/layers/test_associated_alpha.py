"""Alpha that is multiplied into the colours of a file makes no difference to what they become."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from formats.image_files import encode
from small_models import textured_squares

SIDE = 48
CHART = slice(SIDE // 4, 3 * SIDE // 4)
KERNEL = KernelParameters(iterations=2, t=2.0, beta=6.0, beta_growth=1.0, metric_steps=1, free=())
SETTINGS = SmoothSettings(kernel=KERNEL)


def noisy_and_soft():
    """Make noisy colours around two values, and an opacity that falls from 1 to 0 over the chart and beyond."""
    random = np.random.default_rng(3)
    pixels = np.empty((SIDE, SIDE, 4), np.float32)
    pixels[..., :3] = [0.7, 0.5, 0.3]
    pixels[SIDE // 2 :, :, :3] = [0.3, 0.6, 0.5]
    pixels[..., :3] += random.normal(0, 0.04, (SIDE, SIDE, 3))
    pixels[..., 3] = np.clip(np.linspace(1.6, -0.2, SIDE), 0, 1)
    return pixels


def write(path, pixels, kind, *, associated):
    if associated:
        pixels = np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], axis=2)
    known = {".tif": "tiff", ".exr": "openexr"}[path.suffix]
    path.write_bytes(encode(pixels, known, kind, oiio__UnassociatedAlpha=int(not associated)))


def pixels_of(path):
    picture = read_image(path.read_bytes(), path.name)
    full = 1 if picture.pixels.dtype.kind == "f" else np.iinfo(picture.pixels.dtype).max
    return picture.pixels.astype(np.float64) / full


def smoothed_image(path):
    out = path.with_name(f"out-{path.name}")
    beltrami_cli.smooth_file(path, out, SETTINGS)
    return pixels_of(out)


def smoothed_texture(path, settings=SETTINGS):
    """Show the middle of a picture on a square, and return what becomes of all of it."""
    folder = path.parent / f"of-{path.name}"
    folder.mkdir()
    model = textured_squares(path.parent / "square.obj", (path.name, 0, (0.25, 0.75)))
    beltrami_cli.smooth_file(model, folder / "square.obj", settings)
    return pixels_of(folder / f"square_{path.name}")


@pytest.mark.parametrize("smoothed", [smoothed_image, smoothed_texture])
@pytest.mark.parametrize(
    ("suffix", "kind", "step"),
    # Half of a step in the stored colours, and as much again in the colours of all neighbours.
    [("tif", "float", 1e-6), ("exr", "float", 1e-6), ("exr", "half", 2**-11), ("tif", "uint16", 1 / 65535)],
)
def test_colours_become_what_they_become_beside_alpha(smoothed, suffix, kind, step, tmp_path):
    source = noisy_and_soft()
    write(tmp_path / "straight.tif", source, "float", associated=False)
    write(tmp_path / f"within.{suffix}", source, kind, associated=True)
    if kind == "uint16":  # as sRGB, where the numbers are what they are in the other
        write(tmp_path / "straight.tif", source, kind, associated=False)
    expected, found = smoothed(tmp_path / "straight.tif"), smoothed(tmp_path / f"within.{suffix}")
    before = pixels_of(tmp_path / f"within.{suffix}")
    seen = (source[..., 3] > 0.05) & (found != before).any(axis=2)
    assert seen.sum() > SIDE * SIDE / 8
    straight = found[seen, :3] / found[seen, 3:]
    # Errors of the stored colours grow by what they are divided by, and weights follow them.
    bound = 8 * step / found[seen, 3:] + 1e-5
    assert (np.abs(straight - expected[seen, :3]) <= bound).all()
    assert np.array_equal(found[..., 3], before[..., 3])


def test_what_cannot_be_seen_is_given_no_colour(tmp_path):
    write(tmp_path / "within.exr", noisy_and_soft(), "float", associated=True)
    before = pixels_of(tmp_path / "within.exr")
    found = smoothed_texture(tmp_path / "within.exr")
    hidden = before[..., 3] == 0
    assert (found[..., :3] != before[..., :3]).any()
    assert not found[hidden, :3].any()  # colours without opacity would glow
    beyond = np.ones((SIDE, SIDE), bool)
    beyond[CHART, CHART] = False
    gutter = beyond & (before[..., 3] > 0.05) & (found != before).any(axis=2)
    straight = found[gutter, :3] / found[gutter, 3:]
    assert gutter.any()
    assert (np.abs(straight - 0.5) < 0.3).all()


def test_colours_that_are_smoothed_along_with_alpha_are_taken_as_they_are_stored(tmp_path):
    source = noisy_and_soft()
    write(tmp_path / "within.tif", source, "float", associated=True)
    stored = source.copy()
    stored[..., :3] *= stored[..., 3:]
    write(tmp_path / "straight.tif", stored, "float", associated=False)
    settings = SmoothSettings(kernel=KERNEL, textures=TextureSettings(alpha="smooth"))
    expected = smoothed_texture(tmp_path / "straight.tif", settings)
    assert np.array_equal(smoothed_texture(tmp_path / "within.tif", settings), expected)
