"""Image files through `smooth_file`: what stays, which pixels are holes, and what it refuses."""

import numpy as np
import pytest

from beltrami_cli import (
    ImageSettings,
    KernelParameters,
    SmoothSettings,
    UsageError,
    smooth_file,
    smooth_image,
)
from beltrami_cli.fields import override
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.image_surface import ImageSurface
from formats.image_files import RARER_SUFFIXES, SUFFIXES, encode
from hostile.textured_models import ONCE

ROWS, COLUMNS = 36, 44
KINDS = [
    ("png", "uint8", 1), ("png", "uint16", 4), ("tiff", "uint8", 2), ("tiff", "half", 3), ("tiff", "uint16", 5),
    ("openexr", "float", 4), ("openexr", "half", 5), ("bmp", "uint8", 3), ("targa", "uint8", 4), ("jpegxl", "uint8", 3),
    ("pfm", "float", 3),
]  # fmt: skip


def pixels_of(kind, channels, seed=0):
    """Two colours with noise; alpha from 0 to 1 over the columns, 0 in the middle."""
    y, x = np.mgrid[:ROWS, :COLUMNS]
    base = 0.3 + 0.3 * (x > y)[..., None] + np.linspace(0, 0.2, channels)
    values = np.clip(base + np.random.default_rng(seed).normal(0, 0.05, base.shape), 0, 1)
    if channels in (2, 4, 5):
        values[..., 3 if channels == 5 else -1] = np.where(abs(x - 22) < 4, 0, 0.5 + x / 100)
    if kind in ("uint8", "uint16"):
        return np.rint(values * np.iinfo(kind).max).astype(kind)
    return values.astype(np.float16 if kind == "half" else np.float32)


def save(path, pixels, known=None, kind=None, **attributes):
    known = known or next(k for k, suffix in (SUFFIXES | RARER_SUFFIXES).items() if suffix == path.suffix)
    kind = kind or str(pixels.dtype).replace("float32", "float")
    path.write_bytes(encode(pixels, known, kind, **attributes))
    return path


def load(path):
    return read_image(path.read_bytes(), path.name, finite=False)


@pytest.mark.slow
@pytest.mark.parametrize(("known", "kind", "channels"), KINDS)
def test_a_file_keeps_its_type_its_alpha_and_what_cannot_be_seen(known, kind, channels, tmp_path):
    pixels = pixels_of(kind, channels)
    source = save(tmp_path / f"a{(SUFFIXES | RARER_SUFFIXES)[known]}", pixels, known, kind)
    target = tmp_path / f"b{source.suffix}"
    report = smooth_file(source, target)
    old, new = load(source), load(target)
    assert (new.stored, new.kinds, new.channels, new.format) == (old.stored, old.kinds, old.channels, known)
    smoothed = [channel for channel in range(channels) if channel != old.alpha]
    smoothed = old.colour if known == "openexr" else smoothed  # whose other channels are data by their names
    hidden = np.zeros((ROWS, COLUMNS), bool)
    if old.alpha is not None:
        np.testing.assert_array_equal(new.pixels[..., old.alpha], old.pixels[..., old.alpha])
        hidden = old.pixels[..., old.alpha] == 0
        np.testing.assert_array_equal(new.pixels[hidden], old.pixels[hidden])
        assert report.image.image["holes"] == np.count_nonzero(hidden) > 0
    for channel in smoothed:  # noise goes, in every channel
        step = np.abs(np.diff(full_scale_one(new.pixels)[..., channel], axis=1))
        before = np.abs(np.diff(full_scale_one(old.pixels)[..., channel], axis=1))
        seen = ~(hidden[:, 1:] | hidden[:, :-1])
        assert np.median(step[seen]) < 0.5 * np.median(before[seen])


@pytest.mark.slow
def test_the_file_has_what_the_arrays_give(tmp_path):
    pixels = pixels_of("uint16", 3)
    smooth_file(save(tmp_path / "a.tif", pixels), tmp_path / "b.tif")
    assert np.array_equal(load(tmp_path / "b.tif").pixels, smooth_image(pixels).colours)


@pytest.mark.slow
def test_floats_are_linear_light_that_is_smoothed_as_the_eye_sees_it(tmp_path):
    pixels = pixels_of("float", 3)
    smooth_file(save(tmp_path / "a.exr", pixels), tmp_path / "b.exr")
    expected = smooth_image(pixels, encoding="linear", space="srgb").colours
    assert np.abs(load(tmp_path / "b.exr").pixels - expected).max() < 1e-5
    smooth_file(tmp_path / "a.exr", tmp_path / "c.exr", SmoothSettings(space="data"))
    expected = smooth_image(pixels, space="data").colours
    assert np.abs(load(tmp_path / "c.exr").pixels - expected).max() < 1e-6


@pytest.mark.slow
def test_another_extension_converts_and_says_what_is_lost(tmp_path):
    source = save(tmp_path / "a.png", pixels_of("uint16", 4))
    report = smooth_file(source, tmp_path / "b.jpg", jpeg_quality=90)
    assert load(tmp_path / "b.jpg").stored == "uint8"
    assert report.format == "jpg"
    assert any("no alpha" in warning for warning in report.warnings)
    small = tmp_path / "c.jpg"
    smooth_file(source, small, jpeg_quality=20)
    assert small.stat().st_size < (tmp_path / "b.jpg").stat().st_size
    smooth_file(source, tmp_path / "d.exr", SmoothSettings(KernelParameters(iterations=0)))
    assert load(tmp_path / "d.exr").encoding == "linear"
    smooth_file(source, tmp_path / "e", job=Job(format="tif"))
    assert load(tmp_path / "e").format == "tiff"


def test_a_format_that_is_only_read_is_converted_or_refused_before_any_work(tmp_path):
    source, phases = save(tmp_path / "a.fits", pixels_of("uint8", 3)), set()
    job = Job(overwrite=True, progress=lambda phase, *_: phases.add(phase))
    for target in (source, tmp_path / "b.fits"):
        before = source.read_bytes()
        with pytest.raises(UsageError, match=r"cannot be written as FITS; choose \.tif, \.png or \.exr"):
            smooth_file(source, target, job=job)
        assert source.read_bytes() == before
    assert phases <= {"reading", "laying out"}
    smooth_file(source, tmp_path / "b.tif", iterations=1, t=1, beta=9, job=job)
    assert load(tmp_path / "b.tif").pixels.shape == (ROWS, COLUMNS, 3)


def test_channels_beyond_colours_are_smoothed_too_unless_left_out(tmp_path):
    pixels = pixels_of("uint16", 5)
    source = save(tmp_path / "a.tif", pixels)
    report = smooth_file(source, tmp_path / "b.tif", ONCE)
    assert list(report.image.noise)[:3] == ["red", "green", "blue"]
    assert len(report.image.noise) == 4
    assert any("--channels leaves them out" in warning for warning in report.warnings)
    assert (load(tmp_path / "b.tif").pixels != pixels)[..., 4].any()
    report = smooth_file(source, tmp_path / "c.tif", override(ONCE, channels=("r", "green")))
    changed = (load(tmp_path / "c.tif").pixels != pixels).any(axis=(0, 1))
    assert changed.tolist() == [True, True, False, False, False]
    assert report.image.image["smoothed"] == ["red", "green"]
    with pytest.raises(UsageError, match=r"no channel x; .* has red, green, blue"):
        smooth_file(source, tmp_path / "d.tif", SmoothSettings(channels=("x",)))


def test_alpha_is_smoothed_if_asked_for_and_then_nothing_is_hidden(tmp_path):
    pixels = pixels_of("uint16", 4)
    source = save(tmp_path / "a.png", pixels)
    report = smooth_file(source, tmp_path / "b.png", override(ONCE, alpha="smooth"))
    assert list(report.image.noise) == ["red", "green", "blue", "alpha"]
    assert report.image.image["holes"] == 0
    hidden = pixels[..., 3] == 0
    assert (load(tmp_path / "b.png").pixels != pixels)[hidden].any(axis=0)[:3].all()
    assert (load(tmp_path / "b.png").pixels != pixels)[~hidden].any(axis=0).all()


def test_what_is_no_finite_number_is_a_hole_that_stays(tmp_path):
    pixels = pixels_of("float", 3)
    pixels[4:8, 5:9], pixels[20, 30, 1] = np.nan, -np.inf
    source = save(tmp_path / "a.exr", pixels)
    report = smooth_file(source, tmp_path / "b.exr", ONCE)
    holes = ~np.isfinite(pixels).all(axis=2)
    new = load(tmp_path / "b.exr").pixels
    assert new[holes].tobytes() == pixels[holes].tobytes()
    assert np.isfinite(new[~holes]).all()
    assert any("17 pixels" in warning for warning in report.warnings)
    report = smooth_file(source, tmp_path / "b.png", ONCE)
    assert any("NaN becomes 0" in warning for warning in report.warnings)


def test_a_mask_makes_holes_that_stay_and_lend_nothing(tmp_path):
    pixels = pixels_of("uint8", 3)
    mask = np.full((ROWS, COLUMNS, 1), 255, np.uint8)
    mask[:, 20] = 0
    source, shape = save(tmp_path / "a.png", pixels), save(tmp_path / "mask.png", mask)
    settings = SmoothSettings(KernelParameters(beta=10), image=ImageSettings(mask=str(shape)))
    smooth_file(source, tmp_path / "b.png", settings)
    new = load(tmp_path / "b.png").pixels
    np.testing.assert_array_equal(new[:, 20], pixels[:, 20])
    other = pixels.copy()
    other[:, 20:] = 255 - other[:, 20:]
    smooth_file(save(tmp_path / "c.png", other), tmp_path / "d.png", settings)
    np.testing.assert_array_equal(load(tmp_path / "d.png").pixels[:, :20], new[:, :20])


def test_heights_and_positions_are_read_from_images(tmp_path):
    pixels = pixels_of("float", 3)
    source = save(tmp_path / "a.exr", pixels)
    y, x = np.mgrid[:ROWS, :COLUMNS].astype(np.float32)
    height = (np.sin(x / 4) + 2).astype(np.float32)
    height[3, 4] = np.nan
    whole = np.rint(65535 * np.nan_to_num(height) / 4).astype(np.uint16)
    places, seen = np.dstack([x, 2 * y, height]), (x > 5).astype(np.float32)
    # Given, so that the one who calls does not choose by the data.
    fixed = {"beta": 8, "iterations": 5, "t": 2.4, "beta_growth": 2.0, "metric_steps": 2}
    for name, image, options, surface in (
        ("depth.exr", height[..., None], {"height_scale": 5}, ImageSurface(heights=5 * height)),
        ("depth.png", whole[..., None], {"height_scale": 20}, ImageSurface(heights=20 * (whole / 65535))),
        ("places.exr", places, {}, ImageSurface(positions=places)),
        ("seen.exr", np.dstack([places, seen]), {}, ImageSurface(positions=places, valid=seen > 0)),
    ):
        file = {"height" if "depth" in name else "positions": str(save(tmp_path / name, image))}
        settings = SmoothSettings(KernelParameters(**fixed), "data", image=ImageSettings(**file, **options))
        smooth_file(source, tmp_path / "b.exr", settings, job=Job(overwrite=True))
        expected = smooth_image(pixels, surface=surface, **fixed, space="data").colours
        # OpenEXR has alpha multiplied in, and 0 leaves nothing.
        counts = seen > 0 if name == "seen.exr" else np.s_[:]
        assert np.abs(load(tmp_path / "b.exr").pixels - expected)[counts].max() < 1e-6


def test_a_height_may_be_one_channel_of_many_or_grey_in_three(tmp_path):
    source = save(tmp_path / "a.png", pixels_of("uint8", 3))
    render, height = pixels_of("float", 5), np.float32(7) * pixels_of("float", 1)
    render[..., 4:] = height  # R, G, B, A, Z
    results = []
    for name, pixels in (("z.exr", render), ("one.exr", height), ("grey.exr", np.repeat(height, 3, axis=2))):
        path = str(save(tmp_path / name, pixels))
        settings = SmoothSettings(KernelParameters(beta=9, iterations=2), image=ImageSettings(height=path))
        smooth_file(source, tmp_path / f"{name}.png", settings)
        results.append(load(tmp_path / f"{name}.png").pixels)
    np.testing.assert_array_equal(results[1], results[2])
    seen = render[..., 3] > 0
    # From column 19 on pixels are hidden, and two kernels with their metrics reach 10 columns.
    border = np.s_[:, :9]
    assert seen[border].all()
    np.testing.assert_array_equal(results[0][border], results[1][border])
