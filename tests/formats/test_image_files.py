"""Images come back as they were: values, types, alpha, compression and metadata; sizes come from headers."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.image import read_image, to_float, write_image
from beltrami_cli.formats.image.reading import ImageSize, measure_image
from formats.image_files import (
    LOSSLESS,
    RARER,
    RARER_SUFFIXES,
    SUFFIXES,
    encode,
    icc_profile,
    noise,
    png_chunks,
    png_file,
    riff,
    riff_chunks,
    two_pixels,
)  # fmt: skip
from formats.repainting import repainted

_DATE = 306  # tag of TIFF
BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4}
EXIF = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"


@pytest.mark.parametrize(
    ("known", "kind", "channels"),
    [*LOSSLESS, *(pytest.param(*each, marks=pytest.mark.slow) for each in RARER)],
)
def test_every_value_is_read_as_it_was_and_written_back_so(known, kind, channels):
    suffix = (SUFFIXES | RARER_SUFFIXES)[known]
    size = (40, 43) if known in ("jpeg2000", "jpegxl") else (5, 7)  # whose encoders fail on very few pixels
    pixels = noise(kind, channels, *size)
    picture = read_image(encode(pixels, known, kind), f"x{suffix}")
    np.testing.assert_array_equal(picture.pixels, pixels)
    assert picture.pixels.dtype == (np.float32 if kind in ("half", "float") else kind)
    assert picture.stored == {"half": "float16", "float": "float32"}.get(kind, kind)
    assert picture.encoding == ("linear" if kind in ("half", "float") else "srgb")
    assert len(picture.colour) == (1 if channels < 3 else 3)
    assert picture.alpha == (channels - 1 if channels in (2, 4) else None)
    assert [picture.channels[i] for i in picture.colour] == (["Y"] if channels < 3 else ["R", "G", "B"])
    other = noise(kind, channels, *size, seed=1).astype(picture.pixels.dtype)
    for values in (picture.pixels, other):
        written = write_image(picture, values)
        again = read_image(written.data, f"y{suffix}")
        np.testing.assert_array_equal(again.pixels, values)
        assert (again.stored, again.channels, again.format) == (picture.stored, picture.channels, known)
        assert written.suffix == suffix


def test_multiplied_alpha_in_tiff_stays_multiplied():
    pixels = noise("uint8", 4)
    picture = read_image(encode(pixels, "tiff", oiio__UnassociatedAlpha=0), "x.tif")
    stored = picture.pixels
    again = read_image(write_image(picture, stored).data, "x.tif")
    np.testing.assert_array_equal(again.pixels, stored)
    assert not again.spec.get_int_attribute("oiio:UnassociatedAlpha")


@given(st.sampled_from(["uint8", "uint16", "half", "float"]), st.randoms(use_true_random=False))
@settings(max_examples=20, deadline=None)
def test_only_changed_entries_change_and_are_rounded_once(kind, random):
    known = "tiff"
    rng = np.random.default_rng(random.randrange(1 << 30))
    picture = read_image(encode(noise(kind, 4), known, kind), "x.tif")
    values = to_float(picture)
    np.testing.assert_array_equal(repainted(picture, values, np.ones(values.shape, bool)), picture.pixels)
    changed = rng.random(values.shape) < 0.5
    new = rng.normal(0.5, 1, values.shape).astype(np.float32)
    pixels = repainted(picture, new, changed)
    np.testing.assert_array_equal(pixels[~changed], picture.pixels[~changed])
    if kind in ("uint8", "uint16"):
        full = np.iinfo(kind).max
        expected = np.clip(np.rint(np.float64(new) * full), 0, full)
    else:
        expected = new.astype(np.float16) if kind == "half" else new
    np.testing.assert_array_equal(pixels[changed], expected[changed])


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_png_chunks_stay_as_they_are_byte_by_byte(kind):
    plain = png_chunks(encode(noise(kind, 3), "png"))
    before = [
        (b"gAMA", (45455).to_bytes(4)),
        (b"pHYs", bytes([0, 0, 11, 19, 0, 0, 11, 19, 1])),
        (b"tEXt", b"Author\0me"),
        (b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0<x/>"),
        (b"eXIf", EXIF),
        (b"prVt", b"private"),
    ]
    behind = [(b"tEXt", b"Comment\0at the end")]
    pixels = [chunk for chunk in plain if chunk[0] == b"IDAT"]
    end = (b"IEND", b"")
    picture = read_image(png_file([plain[0], *before, *pixels, *behind, end]), "x.png")
    for small in (False, True):
        written = png_chunks(write_image(picture, picture.pixels, small=small).data)
        assert [chunk for chunk in written if chunk[0] != b"IDAT"] == [plain[0], *before, *behind, end]
        kinds = [kind for kind, _ in written]
        assert kinds.index(b"prVt") < kinds.index(b"IDAT") < len(kinds) - 2


def test_palettes_keep_their_chunks_and_take_them_with_them_where_they_become_colours():
    source = two_pixels((b"tRNS", bytes([7])), (b"bKGD", bytes([1])), (b"tEXt", b"Title\0t"))
    picture = read_image(source, "x.png")
    assert picture.pixels.tolist() == [[[1, 2, 3, 7], [200, 100, 50, 255]]]
    written = write_image(picture, picture.pixels).data
    np.testing.assert_array_equal(read_image(written, "x.png").pixels, picture.pixels)
    assert written[24:26] == source[24:26]
    kinds = [kind for kind, _ in png_chunks(written)]
    assert kinds == [b"IHDR", b"tEXt", b"PLTE", b"tRNS", b"bKGD", b"IDAT", b"IEND"]
    others = np.arange(1200, dtype=np.uint16).view(np.uint8).reshape(2, 300, 4)
    written = write_image(dataclasses.replace(picture, pixels=others), others).data
    np.testing.assert_array_equal(read_image(written, "x.png").pixels, others)
    assert [kind for kind, _ in png_chunks(written)] == [b"IHDR", b"tEXt", b"IDAT", b"IEND"]


@pytest.mark.parametrize("progressive", [0, 1])
def test_jpeg_stays_progressive_or_not(progressive):
    pixels = np.linspace(0, 255, 32 * 32 * 3).reshape(32, 32, 3).astype(np.uint8)
    source = encode(pixels, "jpeg", compression="jpeg:80", jpeg__progressive=progressive)
    assert (b"\xff\xc2" in source) == bool(progressive)
    picture = read_image(source, "a.jpg")
    assert (b"\xff\xc2" in write_image(picture, 255 - picture.pixels).data) == bool(progressive)


@pytest.mark.parametrize("subsampling", ["4:4:4", "4:2:2", "4:2:0", "4:1:1"])
def test_jpeg_keeps_subsampling_and_metadata(subsampling):
    smooth = np.linspace(20, 220, 48 * 64 * 3).reshape(48, 64, 3).astype(np.uint8)
    plain = encode(smooth, "jpeg", compression="jpeg:80", jpeg__subsampling=subsampling)
    segments = [
        b"\xff\xe1" + (8 + len(EXIF)).to_bytes(2) + b"Exif\0\0" + EXIF,
        b"\xff\xe2" + (2 + 14 + 132).to_bytes(2) + b"ICC_PROFILE\0\x01\x01" + icc_profile(),
        b"\xff\xfe\0\x07hello",
    ]
    jfif = plain.index(b"\xff\xe0")
    behind = jfif + 2 + int.from_bytes(plain[jfif + 2 : jfif + 4])
    source = plain[:behind] + b"".join(segments) + plain[behind:]
    picture = read_image(source, "x.jpeg")
    best, worst = (write_image(picture, picture.pixels, jpeg_quality=q) for q in (98, 30))
    again = read_image(best.data, "x.jpg")
    assert again.spec.get_string_attribute("jpeg:subsampling") == subsampling
    assert np.abs(again.pixels.astype(int) - picture.pixels).mean() < 1
    assert best.data.startswith(source[: behind + len(b"".join(segments))])
    assert all(best.data.count(segment) == 1 for segment in segments)
    assert len(worst.data) < len(best.data)
    assert best.suffix == ".jpeg"


def test_grey_jpeg_stays_grey():
    picture = read_image(encode(noise("uint8", 1, 16, 16), "jpeg"), "x.jpg")
    assert read_image(write_image(picture, picture.pixels).data, "x.jpg").pixels.shape == (16, 16, 1)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("lossless", [True, False])
def test_webp_keeps_its_kind_and_metadata(channels, lossless):
    pixels = noise("uint8", channels, 9, 12)
    plain = encode(pixels, "webp", compression="lossless" if lossless else "webp:90", webp__method=0)
    chunks = [chunk for chunk in riff_chunks(plain) if chunk[0] != b"VP8X"]
    size = (11).to_bytes(3, "little") + (8).to_bytes(3, "little")
    flags = 0x2C | (0x10 if channels == 4 else 0)
    extended = (b"VP8X", bytes([flags, 0, 0, 0]) + size)
    metadata = [(b"ICCP", icc_profile()), (b"EXIF", EXIF), (b"XMP ", b"<x/>")]
    source = riff([extended, metadata[0], *chunks, *metadata[1:]])
    picture = read_image(source, "x.webp")
    assert picture.pixels.shape == pixels.shape
    file = write_image(picture, picture.pixels)
    assert [bool(re.search(r"a PSNR of \d+\.\d dB", notice)) for notice in file.notices] == [True] * (
        not lossless
    )
    written = riff_chunks(file.data)
    assert written[0] == extended
    assert [chunk for chunk in written if chunk[0] in (b"ICCP", b"EXIF", b"XMP ")] == metadata
    assert any(kind == (b"VP8L" if lossless else b"VP8 ") for kind, _ in written)
    again = read_image(riff(written), "x.webp")
    assert again.pixels.shape == pixels.shape
    if lossless:
        np.testing.assert_array_equal(again.pixels, pixels)


def test_tiff_keeps_profile_compression_and_texts_and_gains_nothing():
    for compression in ("none", "lzw", "zip"):
        source = encode(
            noise("uint16", 3),
            "tiff",
            compression=compression,
            ICCProfile=icc_profile(),
            Artist="me",
            DateTime="",
        )
        picture = read_image(source, "x.tiff")
        written = write_image(picture, picture.pixels)
        again = read_image(written.data, "x.tiff")
        assert written.suffix == ".tiff"
        for name in ("compression", "Artist"):
            assert again.spec.getattribute(name) == picture.spec.getattribute(name)
        assert bytes(again.spec.getattribute("ICCProfile")) == icc_profile()
        names = {attribute.name for attribute in picture.spec.extra_attribs}
        assert {attribute.name for attribute in again.spec.extra_attribs} <= names
        assert write_image(picture, picture.pixels).data == written.data


def test_a_tiff_without_a_date_gets_none():
    def tags(data):
        at = int.from_bytes(data[4:8], "little")
        count = int.from_bytes(data[at : at + 2], "little")
        return [int.from_bytes(data[at + 2 + 12 * i :][:2], "little") for i in range(count)]

    source = encode(noise("uint8", 3), "png")
    plain = write_image(read_image(source, "x.png"), noise("uint8", 3), suffix=".tif").data
    again = write_image(read_image(plain, "x.tif"), noise("uint8", 3)).data
    dated = encode(noise("uint8", 3), "tiff", DateTime="2003:06:12 00:00:00")
    kept = write_image(read_image(dated, "x.tif"), noise("uint8", 3)).data
    assert [_DATE in tags(data) for data in (plain, again, kept)] == [False, False, True]
    assert b"CreateDate" not in plain + again  # of XMP


def test_exr_keeps_compression_types_by_channel_and_attributes():
    pixels = noise("half", 5).astype(np.float32)
    pixels[..., 4] += np.float32(1e-6)
    types = ["half"] * 4 + ["float"]
    source = encode(pixels, "openexr", "float", types, compression="piz", comments="kept", DateTime="")
    picture = read_image(source, "x.exr")
    again = read_image(write_image(picture, picture.pixels).data, "x.exr")
    np.testing.assert_array_equal(again.pixels, picture.pixels)
    assert [str(kind) for kind in again.spec.channelformats] == types
    assert again.spec.get_string_attribute("compression") == "piz"
    assert {(a.name, str(a.value)) for a in again.spec.extra_attribs} == {
        (a.name, str(a.value)) for a in picture.spec.extra_attribs
    }


def test_hdr_keeps_its_own_values():
    picture = read_image(encode(noise("float", 3) ** 2, "hdr", "float"), "x.hdr")
    again = read_image(write_image(picture, picture.pixels).data, "x.hdr")
    np.testing.assert_array_equal(again.pixels, picture.pixels)


def test_without_files_in_memory_temporary_ones_do(monkeypatch, tmp_path):
    monkeypatch.delattr("os.memfd_create", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    pixels = noise("uint16", 4)
    picture = read_image(encode(pixels, "png"), "x.png")
    again = read_image(write_image(picture, picture.pixels).data, "x.png")
    np.testing.assert_array_equal(again.pixels, pixels)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("known", "kind", "channels"), [*LOSSLESS, ("jpeg", "uint8", 3), ("jpeg", "uint8", 1)]
)
def test_the_size_is_that_of_the_pixels(known, kind, channels):
    small, large = noise(kind, channels), noise(kind, channels, 300, 400)
    for pixels in (small, large):
        height, width = pixels.shape[:2]
        expected = ImageSize(width, height, channels, BYTES[kind])
        assert measure_image(encode(pixels, known, kind)) == expected


def test_metadata_before_the_pixels_may_be_long():
    words = np.random.default_rng(1).integers(32, 127, 200_000, np.uint8).tobytes()
    header, *others = png_chunks(encode(noise("uint8", 3), "png"))
    assert measure_image(png_file([header, (b"tEXt", b"Comment\0" + words), *others])) == ImageSize(
        7, 5, 3, 1
    )
    jpeg = encode(noise("uint8", 3), "jpeg")
    segment = b"\xff\xfe" + (60_002).to_bytes(2) + words[:60_000]
    assert measure_image(jpeg[:2] + 3 * segment + jpeg[2:]) == ImageSize(7, 5, 3, 1)


def test_what_is_no_image_has_no_size():
    for data in (b"", b"ply\n", b"\x89PNG", b"\x89PNG" + bytes(1 << 17), b"\xff\xd8\xff" + bytes(1 << 17)):
        assert measure_image(data) is None
