"""Tables of JPEG files are those that another reader finds, and files without any are no JPEG files."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from beltrami_cli.formats.image.metadata import read_jpeg_tables
from formats.image_files import encode

PIXELS = np.random.default_rng(1).integers(0, 256, (40, 56, 3)).astype(np.uint8)
SPANS = {"4:4:4": (0, (1, 1)), "4:2:2": (1, (1, 2)), "4:2:0": (2, (2, 2))}


def saved(pixels=PIXELS, kind="JPEG", mode=None, **options):
    """Return an image file of Pillow's."""
    file, image = io.BytesIO(), Image.fromarray(pixels)
    (image if mode is None else image.convert(mode)).save(file, kind, **options)
    return file.getvalue()


@pytest.mark.parametrize("subsampling", SPANS)
@pytest.mark.parametrize(("quality", "progressive"), [(50, False), (75, True), (92, False), (100, False)])
def test_tables_are_those_that_pillow_reads(subsampling, quality, progressive):
    number, span = SPANS[subsampling]
    data = saved(quality=quality, subsampling=number, progressive=progressive, comment=b"x" * 300)
    found = read_jpeg_tables(memoryview(data))
    with Image.open(io.BytesIO(data)) as image:
        expected = [np.reshape(image.quantization[k], (8, 8)) for k in (0, 1)]
    assert found is not None
    assert found.span == span
    np.testing.assert_array_equal(found.steps, expected)


def test_a_grey_picture_has_one_table():
    found = read_jpeg_tables(saved(mode="L", quality=80))
    assert found is not None
    assert found.steps.shape == (1, 8, 8)
    assert found.span == (1, 1)


def test_files_of_the_own_encoder_are_read():
    data = encode(PIXELS, "jpeg", compression="jpeg:85", jpeg__subsampling="4:2:0")
    found = read_jpeg_tables(data)
    assert found is not None
    assert found.span == (2, 2)
    assert found.steps[0, 0, 0] == 5  # 16 * 30 % of quality 85, rounded


@pytest.mark.parametrize("mode", ["CMYK", "RGB"])
def test_other_colours_than_luma_and_chroma_have_none(mode):
    options = {"keep_rgb": True} if mode == "RGB" else {}
    assert read_jpeg_tables(saved(mode=mode, **options)) is None


def test_steps_of_0_are_none():
    whole = bytearray(saved(quality=85))
    at = whole.index(b"\xff\xdb") + 5
    assert read_jpeg_tables(bytes(whole)).steps[0, 0, 0] == whole[at]
    whole[at] = 0
    assert read_jpeg_tables(bytes(whole)) is None


def test_other_and_damaged_files_have_none_or_the_same():
    whole = saved(quality=85)
    tables = read_jpeg_tables(whole)
    assert read_jpeg_tables(saved(kind="PNG")) is None
    assert read_jpeg_tables(b"") is None
    ends = range(2, whole.index(b"\xff\xda") + 20)
    for end in ends:
        found = read_jpeg_tables(whole[:end])
        assert found is None or np.array_equal(found.steps, tables.steps)
