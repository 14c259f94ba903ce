"""Colours under an alpha of 0, which opaque materials show, come back as all others do."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli import smooth_file
from beltrami_cli.formats.image import read_image, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.inspect import check_files
from formats.gltf_images import with_better_image
from formats.image_files import encode, exact_webp
from formats.test_extra_codecs import BOTH
from hostile.textured_models import write_model


def slopes():
    """Smooth colours, of which the left half has an alpha of 0."""
    rows, columns = np.mgrid[:64, :64] * 4
    return np.stack([columns % 128, rows, 255 - rows, (columns >= 128) * 255], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("known", [*BOTH, "webp"])
def test_lossy_encoders_change_hidden_colours_as_little_as_others(known):
    pixels = slopes()
    written = write_image(new_picture(pixels, "x"), pixels, suffix=f".{known}")
    errors = np.square(read_image(written.data, f"x.{known}").pixels.astype(float) - pixels)[..., :3]
    hidden, seen = errors[:, :32], errors[:, 32:]  # both of the same colours
    assert hidden.mean() < 2 * seen.mean() + 1


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
