"""Images come back as they were, in their own format and in others: values, types, alpha; what does not fit is said.

Images that are damaged, too large or of no use end in one clear error, and never decode first.
"""

import errno
import time
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from beltrami_cli import smooth_file
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.image.conversion import conversion_losses
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.image.sizes import ImageSize, measure_image
from beltrami_cli.formats.image.writing import check_writable, write_image
from beltrami_cli.jobs.noise.kinds import jpeg_file
from beltrami_cli.layers.storing import store
from beltrami_cli.surface.colour_values import linear_to_srgb
from formats.image_files import (
    LOSSLESS,
    ONLY_READ,
    RARER,
    RARER_SUFFIXES,
    SUFFIXES,
    bitmap,
    encode,
    exact_webp,
    icc_profile,
    noise,
    png_chunks,
    png_file,
    riff,
    riff_chunks,
    saved,
    stored,
    with_alpha,
)
from formats.tiff_files import tiff_file

BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4}
FILES = [
    *((*each, False) for each in LOSSLESS),
    *((*each, True) for each in LOSSLESS if each[0] == "tiff" and each[2] in (2, 4)),
    *(pytest.param(*each, False, marks=pytest.mark.slow) for each in (*RARER, *ONLY_READ)),
]


@pytest.mark.parametrize(("known", "kind", "channels", "is_associated"), FILES)
def test_every_value_is_read_as_it_was_and_written_back_so(known, kind, channels, is_associated):
    """Colours under an alpha of 0 too: opaque materials show them."""
    suffix = (SUFFIXES | RARER_SUFFIXES)[known]
    # Some encoders fail on very few pixels.
    size = (40, 43) if known in ("jpeg2000", "j2k", "jpegxl") else (6, 7)
    pixels = noise(kind, channels, *size)
    pixels = with_alpha(pixels) if channels in (2, 4) else pixels
    stored_alpha = {"oiio__UnassociatedAlpha": int(not is_associated)}
    source = exact_webp(pixels) if known == "webp" else encode(pixels, known, kind, **stored_alpha)
    image = read_image(source, f"x{suffix}")
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.pixels.dtype == (np.float32 if kind in ("half", "float") else kind)
    assert image.stored == {"half": "float16", "float": "float32"}.get(kind, kind)
    assert image.encoding == ("linear" if kind in ("half", "float") else "srgb")
    assert image.alpha == (channels - 1 if channels in (2, 4) else None)
    assert [image.channels[i] for i in image.colour] == (["Y"] if channels < 3 else ["R", "G", "B"])
    if known in SUFFIXES:
        assert measure_image(source) == ImageSize(size[1], size[0], channels, BYTES[kind])
    target = None
    if (known, kind, channels) in ONLY_READ:
        refusal = r"^x\.\w+: images cannot be written as [^\n]*; choose \.tif, \.png or \.exr as [^\n]*$"
        with pytest.raises(UsageError, match=refusal):
            check_writable(image, None)
        known, suffix = "tiff", ".tif"
        target = suffix
    for values, small in ((image.pixels, False), (image.pixels[::-1, ::-1], True)):
        written = write_image(image, values, suffix=target, small=small)
        again = read_image(written.data, f"y{suffix}")
        np.testing.assert_array_equal(again.pixels, values)
        assert (again.stored, again.channels, again.format) == (image.stored, image.channels, known)
        assert written.suffix == suffix
        if known == "tiff" and channels in (2, 4):
            assert again.spec.get_int_attribute("oiio:UnassociatedAlpha") != is_associated


def with_values(image, values, changed):
    """Return the pixels of an image, of which some numbers are stored anew from float values."""
    pixels = image.pixels.copy()
    table, wanted = pixels.reshape(-1, pixels.shape[2]), changed.reshape(-1, pixels.shape[2])
    for channel, rows in enumerate(map(np.flatnonzero, wanted.T)):
        new = values.reshape(table.shape)[rows, channel, None]
        store(image, table, rows, new, [channel], threads=1)
    return pixels


@given(st.sampled_from(["uint8", "uint16", "half", "float", "mixed"]), st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_only_changed_entries_change_and_are_rounded_once(kind, seed):
    rng, channels = np.random.default_rng(seed), ["half"] * 4 + ["float"] if kind == "mixed" else [kind] * 4
    if kind == "mixed":
        image = read_image(encode(noise("float", 5), "openexr", "float", channels), "x.exr")
    else:
        image = read_image(encode(noise(kind, 4), "tiff", kind), "x.tif")
    values = full_scale_one(image.pixels)
    np.testing.assert_array_equal(with_values(image, values, np.ones(values.shape, bool)), image.pixels)
    changed = rng.random(values.shape) < 0.5
    new = rng.normal(0.5, 1, values.shape).astype(np.float32)
    pixels = with_values(image, new, changed)
    np.testing.assert_array_equal(pixels[~changed], image.pixels[~changed])
    for channel, name in enumerate(channels):
        if name in ("uint8", "uint16"):
            full = np.iinfo(name).max
            expected = np.clip(np.rint(np.float64(new) * full), 0, full)
        else:
            expected = new.astype(np.float16) if name == "half" else new
        mine = changed[..., channel]
        np.testing.assert_array_equal(pixels[mine, channel], expected[mine, channel])
    again = read_image(write_image(image, pixels).data, "x")
    np.testing.assert_array_equal(again.pixels, pixels)
    if kind == "mixed":
        tiff = read_image(write_image(image, pixels, suffix=".tif").data, "x.tif")
        assert tiff.stored == "float32"
        np.testing.assert_array_equal(
            tiff.pixels[..., 3:], pixels[..., 3:]
        )  # alpha is divided out of colours


@pytest.mark.parametrize(
    ("known", "channels", "options", "mark"),
    [
        ("jpeg", 1, {}, b"\xff\xc0\0\x0b"),
        ("jpeg", 3, {"jpeg__progressive": 0}, b"\xff\xc0"),
        ("jpeg", 3, {"jpeg__progressive": 1}, b"\xff\xc2"),
        *(("jpeg", 3, {"jpeg__subsampling": ratio}, None) for ratio in ("4:4:4", "4:2:2", "4:2:0")),
        *(("tiff", 3, {"compression": name}, None) for name in ("none", "lzw", "zip")),
        ("openexr", 4, {"compression": "piz"}, None),
        ("webp", 3, {"compression": "lossless"}, b"VP8L"),
        ("webp", 4, {"compression": "webp:90"}, b"VP8 "),
    ],
)
def test_the_coding_of_the_pixels_stays(known, channels, options, mark):
    """Lossy files cost little more than their own quality; with less quality a file is smaller."""
    kind = "half" if known == "openexr" else "uint8"
    smooth = np.linspace(0.1, 0.9, 48 * 64 * channels).reshape(48, 64, channels)
    pixels = smooth.astype(np.float16) if kind == "half" else np.rint(255 * smooth).astype(np.uint8)
    source = encode(pixels, known, kind, **options)
    image = read_image(source, "x" + SUFFIXES[known])
    new = image.pixels[::-1]
    best, worst = (write_image(image, new, jpeg_quality=quality) for quality in (98, 30))
    again = read_image(best.data, "x" + SUFFIXES[known])
    assert np.abs(again.pixels.astype(float) - new).mean() < 1
    assert (len(worst.data) < len(best.data)) == (known == "jpeg" or mark == b"VP8 ")
    if mark is not None:
        assert mark in source
        assert mark in best.data
    for name in () if mark else options:
        attribute = name.replace("__", ":")
        assert again.spec.getattribute(attribute) == image.spec.getattribute(attribute) == options[name]


def picture_of(known, kind, channels):
    pixels = noise(kind, channels, 16, 24)
    if kind in ("half", "float"):
        pixels = np.clip(pixels, 0, 1)
    return read_image(encode(pixels, known, kind), "skin" + SUFFIXES[known])


# Each file in a third of the formats, each format from a third of the files.
@pytest.mark.parametrize(
    ("known", "kind", "channels", "target"),
    [
        (*each, target)
        for i, each in enumerate(LOSSLESS)
        for j, target in enumerate(sorted(SUFFIXES.values()))
        if (i + j) % 3 == 0 or target == SUFFIXES[each[0]]
    ],
)
def test_every_format_can_be_written_as_every_other(known, kind, channels, target):
    image = picture_of(known, kind, channels)
    written = write_image(image, image.pixels, suffix=target)
    assert written.suffix == target
    again = read_image(written.data, "x" + target)
    assert again.pixels.shape[:2] == image.pixels.shape[:2]
    said = " ".join(conversion_losses(image, target))
    assert any("PSNR" in notice for notice in written.notices) == (target == ".webp" != SUFFIXES[known])
    assert ("no alpha" in said) == (image.alpha is not None and again.alpha is None)
    assert ("equal red" in said) == (len(again.colour) > len(image.colour))
    bits = {"uint8": 8, "uint16": 16, "float16": 16, "float32": 32}
    fewer = bits[again.stored] < bits[image.stored]
    assert (f"{bits[again.stored]}-bit" in said) == (fewer or image.encoding < again.encoding)
    if target == SUFFIXES[known]:
        assert not said
    # Half floats have eleven bits. HDR has eight for the largest channel, fewer for the others.
    rounding = {"uint8": 0.51 / 255, "uint16": 0.51 / 65535, "float16": 2**-10, "float32": 1e-5}[again.stored]
    rounding, worst = (2 / 255, np.median) if target == ".hdr" else (rounding, np.max)
    is_seen = image.alpha is None or full_scale_one(image.pixels)[..., image.alpha] > 0.01
    for as_data in (False, True) if target not in (".jpg", ".webp") else ():
        written = write_image(image, image.pixels, suffix=target, as_data=as_data)
        found, expected = (shown(each, as_data) for each in (read_image(written.data, "x" + target), image))
        assert worst(np.abs(found - expected)[is_seen]) <= rounding


def shown(image, as_data):
    """Return red, green and blue as display values, or as stored if they are data."""
    values = full_scale_one(image.pixels)
    colours = values[..., list(image.colour)]
    if image.format == "openexr" and image.alpha is not None:  # which multiplies colours by alpha
        colours = colours / np.maximum(values[..., image.alpha, None], 0.01)
    colours = linear_to_srgb(colours) if image.encoding == "linear" and not as_data else colours
    return np.broadcast_to(colours, (*values.shape[:2], 3)).clip(0, 1)


@pytest.mark.parametrize(
    ("suffix", "channels", "start"),
    [(".pfm", 3, b"PF"), (".ppm", 1, b"P6"), (".pgm", 1, b"P5"), (".pnm", 1, b"P5"), (".pnm", 3, b"P6")],
)
def test_files_hold_what_their_extension_says(suffix, channels, start):
    image = new_image(noise("uint8", channels, 32, 32), "x")
    assert write_image(image, image.pixels, suffix=suffix).data.startswith(start)


@pytest.mark.parametrize("suffix", [*SUFFIXES.values(), ".pfm", ".ppm"])
def test_a_single_pixel_is_read_back(suffix):
    image = new_image(np.full((1, 1, 3), 200, np.uint8), "x")
    file = write_image(image, image.pixels, suffix=suffix)
    again = shown(read_image(file.data, f"x{suffix}"), as_data=False)
    np.testing.assert_allclose(again, 200 / 255, atol=2 / 255)
    assert "PSNR of inf" not in str(file.notices)


@pytest.mark.parametrize("known", ["bmp", "targa"])
def test_no_opacity_at_all_counts_as_full_opacity(known):
    pixels = noise("uint8", 4) * np.uint8([1, 1, 1, 0])
    source = encode(pixels, known)
    image = read_image(source, f"x{SUFFIXES[known]}")
    np.testing.assert_array_equal(image.pixels, pixels + np.uint8([0, 0, 0, 255]))
    assert "opacity of 0 everywhere" in image.notices[-1]
    assert write_image(image, image.pixels).data == source  # the format keeps it


def test_a_format_that_multiplies_colours_by_alpha_says_what_it_loses():
    pixels = with_alpha(noise("uint8", 4))
    for hidden in (pixels, np.where(pixels[..., 3:] == 0, 0, pixels)):
        lost = conversion_losses(read_image(encode(hidden, "png"), "x.png"), ".exr")
        assert any("under an alpha of 0 are lost" in notice for notice in lost) == (hidden is pixels)


def test_a_profile_goes_along_where_it_still_holds():
    source = encode(noise("uint8", 3), "tiff", ICCProfile=icc_profile(), Artist="me", DateTime="")
    image = read_image(source, "x.tif")
    png = dict(png_chunks(write_image(image, image.pixels, suffix=".png").data))
    name, _, packed = png[b"iCCP"].partition(b"\0")
    assert zlib.decompress(packed[1:]) == icc_profile()
    assert png[b"tEXt"] == b"Author\0me"
    assert not {b"sRGB", b"gAMA", b"cHRM", b"zTXt"} & png.keys()  # which may not stand beside a profile
    assert len(name) > 0
    exr = read_image(write_image(image, image.pixels, suffix=".exr").data, "x.exr")
    assert exr.spec.getattribute("ICCProfile") is None


@pytest.mark.parametrize("turned", range(1, 9))
def test_where_no_tag_turns_an_image_its_pixels_are_turned(turned, tmp_path):
    source = tmp_path / "a.tif"
    source.write_bytes(encode(noise("uint8", 3), "tiff", Orientation=turned))
    upright = OpenImageIO.ImageBufAlgo.reorient(OpenImageIO.ImageBuf(str(source)))
    report = smooth_file(source, tmp_path / "b.bmp", iterations=0)
    np.testing.assert_array_equal(stored(tmp_path / "b.bmp"), upright.get_pixels("uint8"))
    assert any("pixels are turned" in warning for warning in report.warnings) == (turned > 1)
    smooth_file(source, tmp_path / "b.png", iterations=0)
    np.testing.assert_array_equal(stored(tmp_path / "b.png"), noise("uint8", 3))


LATIN_1 = {
    "channel": (b"Z\0", b"\xeb\0"),
    "name": (b"title\0", b"titl\xeb\0"),
    "name that is left out": (b"title\0", b"gif:\xeb\0"),
    "value": (b"Zoe", b"Zo\xeb"),
}


@pytest.mark.parametrize("what", LATIN_1)
def test_texts_that_are_no_utf_8_bar_no_format(what):
    data = encode(noise("float", 5, 8, 8), "openexr", "float", compression="none", title="Zoe")
    old, new = LATIN_1[what]
    assert old in data
    image = read_image(data.replace(old, new), "x.exr")
    written = write_image(image, image.pixels)
    again = read_image(written.data, "x.exr")
    np.testing.assert_array_equal(again.pixels, image.pixels)
    assert again.channels == image.channels
    assert new in written.data or what == "name that is left out"
    for suffix in (".tif", ".png", ".jpg", ".webp"):
        converted = write_image(image, image.pixels, suffix=suffix)
        assert read_image(converted.data, f"x{suffix}").pixels.shape[:2] == (8, 8)
    header, *others = png_chunks(encode(noise("uint8", 3), "png"))
    image = read_image(png_file([header, (b"tEXt", b"Author\0Zo\xeb"), *others]), "x.png")
    assert b"Zo\xeb" in write_image(image, image.pixels, suffix=".jpg").data


def test_a_jpeg_that_coding_would_change_more_than_the_result_stays():
    """Hues of single pixels, stored for 2 x 2 of them, are lost by far more than a step in one pixel."""
    hues = np.random.default_rng(0).random((64, 64, 3), np.float32)
    subsampled = jpeg_file(hues, 90)
    image = read_image(subsampled, "in.jpg")
    nearly = image.pixels.copy()
    nearly[0, 0, 0] ^= 1
    kept = write_image(image, nearly)
    assert kept.data == subsampled
    assert kept.notices[0].startswith("in.jpg stays as it is")
    assert write_image(image, image.pixels // 2).data != subsampled


def test_without_files_in_memory_temporary_ones_do(monkeypatch, tmp_path):
    monkeypatch.delattr("os.memfd_create", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    pixels = noise("uint16", 4)
    image = read_image(encode(pixels, "png"), "x.png")
    again = read_image(write_image(image, image.pixels).data, "x.png")
    np.testing.assert_array_equal(again.pixels, pixels)
    assert list(tmp_path.iterdir()) == []


def test_metadata_before_the_pixels_may_be_long():
    words = np.random.default_rng(1).integers(32, 127, 200_000, np.uint8).tobytes()
    header, *others = png_chunks(encode(noise("uint8", 3), "png"))
    jpeg = encode(noise("uint8", 3), "jpeg")
    segment = b"\xff\xfe" + (60_002).to_bytes(2) + words[:60_000]
    files = (png_file([header, (b"tEXt", b"Comment\0" + words), *others]), jpeg[:2] + 3 * segment + jpeg[2:])
    assert [measure_image(data) for data in files] == [ImageSize(7, 5, 3, 1)] * 2
    for data in (b"", b"ply\n", b"\x89PNG", b"\x89PNG" + bytes(1 << 17), b"\xff\xd8\xff" + bytes(1 << 17)):
        assert measure_image(data) is None


KINDS = {known: each for known, *each in (*LOSSLESS, ("jpeg", "uint8", 3), ("hdr", "float", 3))}


def sample(known):
    kind, channels = KINDS[known]
    return encode(noise(kind, channels, 24, 24), known, kind)


def png(width, height, lines=b""):
    header = width.to_bytes(4) + height.to_bytes(4) + bytes([8, 2, 0, 0, 0])
    return png_file([(b"IHDR", header), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")])


@pytest.mark.parametrize("known", sorted(KINDS))
def test_a_cut_off_image_is_refused_by_name(known):
    data = sample(known)
    pixels = len(data) - (521 if known == "targa" else 0)  # A TGA file ends with a table that may be missing.
    for part in (0.02, 0.3, 0.6, 0.9):
        with pytest.raises(InputError) as raised:
            read_image(data[: int(part * pixels)], "skin" + SUFFIXES[known])
        assert raised.value.name == "skin" + SUFFIXES[known]
        assert "/proc" not in str(raised.value)
        assert "\n" not in str(raised.value)
        assert OpenImageIO.geterror() == ""


@pytest.mark.parametrize("size", [(0, 4), (4, 0), (1 << 30, 1), (1, 1 << 30), (65535, 65535)])
def test_images_of_no_or_too_large_a_size_are_refused_by_their_header(size):
    begin = time.process_time()
    with pytest.raises(InputError, match=r"\d+ x \d+ pixels|size|damaged"):
        read_image(png(*size, bytes(1 << 16)), "bomb.png")
    assert time.process_time() - begin < 1


def inks(transform):
    """Return a CMYK file whose inks are stored as they are (0), or as luma and chroma (2), as Adobe's segment says."""
    jpeg = bytearray(saved(Image.fromarray(noise("uint8", 4), "CMYK"), ".jpg"))
    jpeg[jpeg.index(b"Adobe") + 11] = transform
    return bytes(jpeg)


# OpenImageIO reads the white of CIELAB as (255, 252, 222), ignores masks, and takes the green of a palette for alpha.
_PALETTE = {262: (3, [3]), 320: (3, [0] * 768), 338: (3, [2])}
_UNFIT = {
    "the file is empty": ("x.png", b""),
    "no known image format": ("x.png", b"RIFF\0\0\0\0WAVE"),
    "GIF image is damaged": ("x.png", b"GIF89a" + bytes(30)),
    "HEIC": ("x.heic", bytes(4) + b"ftypheic" + bytes(20)),
    "could not find a format": ("x.tga", b"hello"),
    "damaged or cut off": ("x.tga", sample("targa")[:12] + bytes(2) + sample("targa")[14:]),
    "the inks of print": ("x.jpg", inks(0)),
    "CMYK.*; convert it to RGB": ("x.jpg", inks(2)),
    "CMYK": ("x.tif", encode(noise("uint8", 4), "tiff", tiff__ColorSpace="CMYK")),
    "its colours are CIELAB; convert": ("x.tif", saved(Image.fromarray(noise("uint8", 3), "LAB"), ".tif")),
    "a palette with an alpha channel; convert it to RGBA": ("x.tif", tiff_file(noise("uint8", 2), _PALETTE)),
    "the order of its red, .* that is not read; export": ("x.bmp", bitmap(0xFF, 0xFF00, 0xFF0000, 0)),
    "the scale in its header is 0": ("x.pfm", b"PF\n1 1\n-0.0\n" + bytes(12)),
    "scale in its header .* no number": ("x.pfm", b"PF\n1 1\nnan\n" + bytes(12)),
    "scale in its header": ("x.pfm", b"Pf\n1 1\n1e-300\n" + bytes(4)),
    "6 of its values are not finite": ("x.exr", encode(np.full((2, 1, 3), np.nan), "openexr", "float")),
    # JPEG 2000, which libtiff never decodes.
    "does not read how .* save it without": ("x.tif", tiff_file(noise("uint8", 3), {259: (3, [34712])})),
    "int16": ("x.tif", encode(noise("uint8", 3).astype(np.int16), "tiff", "int16")),
}  # fmt: skip


@pytest.mark.parametrize("cause", _UNFIT)
def test_colours_and_values_that_cannot_be_used_are_refused(cause):
    name, source = _UNFIT[cause]
    with pytest.raises(InputError, match=f"{name}: .*{cause}"):
        read_image(source, name)


def test_of_an_animation_the_first_image_is_taken_and_said_so():
    frames = []
    for seed in (0, 1):
        pixels = noise("uint8", 4, 8, 8, seed)
        pixels[..., 3] = 255
        payload = riff(riff_chunks(encode(pixels, "webp")))[12:]
        frames.append((b"ANMF", bytes(6) + bytes([7, 0, 0, 7, 0, 0, 100, 0, 0, 0]) + payload))
    chunks = [(b"VP8X", bytes([0x12, 0, 0, 0, 7, 0, 0, 7, 0, 0])), (b"ANIM", bytes(6)), *frames]
    image = read_image(riff(chunks), "moving.webp")
    assert image.pixels.shape[:2] == (8, 8)
    assert "moving.webp holds several images" in image.notices[0]
    assert not read_image(sample("webp"), "still.webp").notices


def test_no_room_for_a_copy_names_the_image(monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    data = sample("png")
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"skin\.png: there is no room for a copy of its \d+ bytes"):
        read_image(data, "skin.png")
