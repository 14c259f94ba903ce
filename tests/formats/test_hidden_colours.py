"""Colours under an alpha of 0, which opaque materials show, come back as all others do."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from beltrami_cli import smooth_file
from beltrami_cli.formats.image import losses, read_image, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.inspect import check_files
from formats.gltf_images import with_better_image
from formats.image_files import LOSSLESS, RARER, RARER_SUFFIXES, SUFFIXES, encode, noise
from formats.test_extra_codecs import BOTH
from formats.test_image_kinds import dds
from hostile.textured_models import write_model

WITH_ALPHA = [(*each, False) for each in (*LOSSLESS, *RARER) if each[2] in (2, 4)]
WITH_ALPHA += [(*each, True) for each in LOSSLESS if each[0] == "tiff" and each[2] in (2, 4)]
LOSSY = [*BOTH, "webp"]


def with_alpha(pixels):
    """Give rows of pixels, by turns, an alpha of 0, of 1, and any."""
    integer = pixels.dtype.kind == "u"
    pixels[::3, :, -1] = 0
    pixels[1::3, :, -1] = np.iinfo(pixels.dtype).max if integer else 1
    return pixels


def exact_webp(pixels, **options):
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "WEBP", lossless=True, exact=True, **options)
    return buffer.getvalue()


def file_of(pixels, known, kind, **attributes):
    return exact_webp(pixels) if known == "webp" else encode(pixels, known, kind, **attributes)


@pytest.mark.parametrize(("known", "kind", "channels", "is_associated"), WITH_ALPHA)
def test_colours_are_kept_whatever_the_alpha(known, kind, channels, is_associated):
    suffix = (SUFFIXES | RARER_SUFFIXES)[known]
    pixels = with_alpha(noise(kind, channels, 40, 43))
    source = file_of(pixels, known, kind, oiio__UnassociatedAlpha=int(not is_associated))
    picture = read_image(source, f"x{suffix}")
    np.testing.assert_array_equal(picture.pixels, pixels)
    new = picture.pixels[::-1, ::-1]
    for small in (False, True):
        again = read_image(write_image(picture, new, small=small).data, f"x{suffix}")
        np.testing.assert_array_equal(again.pixels, new)


def test_colours_of_transparent_entries_of_a_palette_are_kept():
    image = Image.fromarray(np.arange(16, dtype=np.uint8).reshape(4, 4), "P")
    image.putpalette(np.random.default_rng(0).integers(1, 256, 48).astype(np.uint8).tobytes())
    buffer = io.BytesIO()
    image.save(buffer, "PNG", transparency=bytes([0, 0, 7, 255] * 4))
    picture = read_image(buffer.getvalue(), "x.png")
    assert picture.pixels[..., :3].tobytes() == bytes(image.getpalette()[:48])
    again = read_image(write_image(picture, picture.pixels[::-1]).data, "x.png")
    np.testing.assert_array_equal(again.pixels, picture.pixels[::-1])


def test_colours_under_an_alpha_of_0_are_read_from_dds():
    pixels = with_alpha(noise("uint8", 4))
    picture = read_image(dds(pixels), "x.dds")
    np.testing.assert_array_equal(picture.pixels, pixels)
    again = read_image(write_image(picture, picture.pixels, suffix=".png").data, "x.png")
    np.testing.assert_array_equal(again.pixels, pixels)


def slopes():
    """Smooth colours, of which the left half has an alpha of 0."""
    rows, columns = np.mgrid[:64, :64] * 4
    return np.stack([columns % 128, rows, 255 - rows, (columns >= 128) * 255], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("known", LOSSY)
def test_lossy_encoders_change_hidden_colours_as_little_as_others(known):
    pixels = slopes()
    written = write_image(new_picture(pixels, "x"), pixels, suffix=f".{known}")
    errors = np.square(read_image(written.data, f"x.{known}").pixels.astype(float) - pixels)[..., :3]
    hidden, seen = errors[:, :32], errors[:, 32:]  # both of the same colours
    assert hidden.mean() < 2 * seen.mean() + 1


def test_a_format_that_multiplies_colours_by_alpha_says_what_it_loses():
    pixels = with_alpha(noise("uint8", 4))
    for hidden in (pixels, np.where(pixels[..., 3:] == 0, 0, pixels)):
        picture = read_image(encode(hidden, "png"), "x.png")
        told = [notice for notice in losses(picture, ".exr") if "under an alpha of 0 are lost" in notice]
        assert len(told) == (hidden is pixels)


def model(pixels, mode):
    """Return a triangle that shows half of a texture in lossless WebP."""
    found = with_better_image("webp", exact_webp(pixels))
    found.tree["materials"][0]["alphaMode"] = mode
    return found


def texture_of(path):
    (texture,) = open_document(str(path)).textured("baseColor").textures
    return read_image(texture.data, texture.name).pixels


@pytest.mark.parametrize("mode", ["OPAQUE", "MASK", "BLEND"])
def test_hidden_texels_of_a_model_stay_unless_they_are_seen(tmp_path, mode):
    pixels = slopes()
    pixels[..., :3] = np.random.default_rng(2).normal(100, 8, (64, 64, 3))
    source, target = model(pixels, mode).written_to(tmp_path), tmp_path / "out.glb"
    smooth_file(source, target, iterations=1, t=8, beta=5, gutter=None)
    new = texture_of(target)
    changed, hidden = (new != pixels).any(axis=2), pixels[..., 3] == 0
    assert (changed & ~hidden).any()
    assert check_files(source, target).faithful
    if mode == "OPAQUE":
        assert (changed & hidden).any()
        assert new[changed & hidden, :3].std() < 8 / 2
    else:
        assert not (changed & hidden).any()


def test_check_reports_hidden_colours_that_were_cleared(tmp_path):
    pixels = slopes()
    pixels[..., 0] |= 1
    is_hidden = pixels[..., 3:] == 0
    images = pixels, np.where(is_hidden, 0, pixels), np.where(is_hidden, pixels // 2, pixels)
    models = []
    for name, image in zip("abc", images, strict=True):
        models.append(write_model(tmp_path / name, "gltf", "a.png"))
        (tmp_path / name / "a.png").write_bytes(encode(image, "png"))
    report = check_files(*models[:2])
    assert not report.faithful
    assert f"{is_hidden.sum()} pixels under an alpha of 0 lost their colours" in report.differences[0].detail
    assert check_files(models[0], models[2]).faithful
