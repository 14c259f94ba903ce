"""Palettes: their colours are kept, and it is told that they become full colours."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from beltrami_cli.formats.image import read_image
from formats.image_files import noise

SUFFIXES = [".png", ".bmp", ".tga", ".tif", ".gif"]


def encoded(picture: Image.Image, suffix: str) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, Image.registered_extensions()[suffix])
    return buffer.getvalue()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_palette_of_colours_is_told_of_and_resolved(suffix: str) -> None:
    colours = Image.fromarray(noise("uint8", 3, 16, 16)).quantize(16)
    picture = read_image(encoded(colours, suffix), f"x{suffix}")
    assert any("palette" in notice for notice in picture.notices)
    shown = np.asarray(colours.convert("RGB")).astype(int)
    # Pillow multiplies levels by 256 for the 16 bits of a TIFF, of which the full scale is 257 times 255.
    assert np.abs(picture.pixels[..., :3] - shown).max() <= (1 if suffix == ".tif" else 0)


@pytest.mark.parametrize("suffix", SUFFIXES[:-1])
@pytest.mark.parametrize("kind", ["RGB", "L"])
def test_full_colours_and_greys_are_no_palette(kind: str, suffix: str) -> None:
    plain = Image.fromarray(noise("uint8", 3, 16, 16)).convert(kind)
    assert not read_image(encoded(plain, suffix), f"x{suffix}").notices
