"""From one image format to another: what fits is kept, what does not is said."""

from __future__ import annotations

import zlib

import numpy as np
import OpenImageIO
import pytest

from beltrami_cli import smooth_file
from beltrami_cli.errors import UsageError
from beltrami_cli.formats.image import losses, read_image, to_float, write_image
from beltrami_cli.jobs.noise_targets import jpeg_file
from beltrami_cli.surface.records import linear_to_srgb
from formats.image_files import LOSSLESS, SUFFIXES, encode, icc_profile, noise, png_chunks, png_file, stored

RGB = [(known, kind) for known, kind, channels in LOSSLESS if channels == 3]


def picture_of(known, kind, channels, low=0):
    pixels = noise(kind, channels, 16, 24)
    if kind in ("half", "float"):
        pixels = np.clip(pixels, low, 1)
    return read_image(encode(pixels, known, kind), "skin" + SUFFIXES[known])


@pytest.mark.slow
@pytest.mark.parametrize("target", sorted(SUFFIXES.values()))
@pytest.mark.parametrize(("known", "kind", "channels"), LOSSLESS)
def test_every_format_can_be_written_as_every_other(known, kind, channels, target):
    picture = picture_of(known, kind, channels)
    written = write_image(picture, picture.pixels, suffix=target)
    assert written.suffix == target
    again = read_image(written.data, "x" + target)
    assert again.pixels.shape[:2] == picture.pixels.shape[:2]
    said = " ".join(losses(picture, target))
    assert ("no alpha" in said) == (picture.alpha is not None and again.alpha is None)
    assert ("equal red" in said) == (len(again.colour) > len(picture.colour))
    bits = {"uint8": 8, "uint16": 16, "float16": 16, "float32": 32}
    fewer = bits[again.stored] < bits[picture.stored]
    assert (f"{bits[again.stored]}-bit" in said) == (fewer or picture.encoding < again.encoding)
    if target == SUFFIXES[known]:
        assert not said


@pytest.mark.parametrize(("known", "kind"), RGB)
def test_numbers_survive_the_way_to_a_format_that_holds_them(known, kind):
    picture = picture_of(known, kind, 3)
    for target in (".tif", ".png" if kind in ("uint8", "uint16") else ".exr"):
        again = read_image(write_image(picture, picture.pixels, suffix=target).data, "x" + target)
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        assert again.stored == picture.stored


def test_light_becomes_display_values_in_integers_and_data_stay():
    picture = picture_of("openexr", "float", 3)
    colours = read_image(write_image(picture, picture.pixels, suffix=".png").data, "x.png")
    assert colours.stored == "uint16"
    np.testing.assert_allclose(to_float(colours), linear_to_srgb(picture.pixels), atol=0.51 / 65535)
    data = read_image(write_image(picture, picture.pixels, suffix=".png", as_data=True).data, "x.png")
    np.testing.assert_allclose(to_float(data), picture.pixels, atol=0.51 / 65535)


def test_display_values_come_back_from_light():
    picture = picture_of("png", "uint8", 3)
    for target in (".exr", ".hdr"):
        light = read_image(write_image(picture, picture.pixels, suffix=target).data, "x" + target)
        assert light.encoding == "linear"
        bound = (
            2 if target == ".hdr" else 0
        )  # HDR has eight bits for the largest channel, fewer for the others.
        back = np.rint(255 * linear_to_srgb(light.pixels))
        error = np.abs(back - picture.pixels)
        assert np.median(error) <= bound
        assert target == ".hdr" or error.max() == 0


def test_alpha_is_divided_out_and_multiplied_in_where_formats_differ():
    picture = picture_of("png", "uint16", 4)
    exr = read_image(write_image(picture, picture.pixels, suffix=".exr", as_data=True).data, "x.exr")
    whole = to_float(picture)
    np.testing.assert_allclose(exr.pixels[..., :3], whole[..., :3] * whole[..., 3:], rtol=1e-6)
    back = read_image(write_image(exr, exr.pixels, suffix=".png", as_data=True).data, "x.png")
    thick = whole[..., 3] > 0.01
    np.testing.assert_allclose(to_float(back)[thick], whole[thick], atol=1e-4)


def test_profile_and_texts_go_along_where_they_still_hold():
    source = encode(noise("uint8", 3), "tiff", ICCProfile=icc_profile(), Artist="me", DateTime="")
    picture = read_image(source, "x.tif")
    png = dict(png_chunks(write_image(picture, picture.pixels, suffix=".png").data))
    name, _, packed = png[b"iCCP"].partition(b"\0")
    assert zlib.decompress(packed[1:]) == icc_profile()
    assert png[b"tEXt"] == b"Author\0me"
    assert not {b"sRGB", b"gAMA", b"cHRM", b"zTXt"} & png.keys()  # which may not stand beside a profile
    assert len(name) > 0
    exr = read_image(write_image(picture, picture.pixels, suffix=".exr").data, "x.exr")
    assert exr.spec.getattribute("ICCProfile") is None


@pytest.mark.parametrize("target", [".jpg", ".png", ".tif", ".webp"])
@pytest.mark.parametrize("source", ["jpeg", "png", "tiff"])
def test_exif_goes_along(source, target):
    data = encode(noise("uint8", 3), source, Orientation=6, ImageDescription="a view", DateTime="")
    picture = read_image(data, "x" + SUFFIXES[source])
    spec = read_image(write_image(picture, picture.pixels, suffix=target).data, "x" + target).spec
    assert spec.get_int_attribute("Orientation") == 6
    assert spec.get_string_attribute("ImageDescription") == "a view"


def test_a_picture_without_exif_gets_none():
    picture = picture_of("png", "uint8", 3)
    assert b"EXIF" not in write_image(picture, picture.pixels, suffix=".webp").data


@pytest.mark.parametrize("turned", range(1, 9))
def test_where_no_tag_turns_a_picture_its_pixels_are_turned(turned, tmp_path):
    source = tmp_path / "a.tif"
    source.write_bytes(encode(noise("uint8", 3), "tiff", Orientation=turned))
    upright = OpenImageIO.ImageBufAlgo.reorient(OpenImageIO.ImageBuf(str(source)))
    report = smooth_file(source, tmp_path / "b.bmp", iterations=0)
    np.testing.assert_array_equal(stored(tmp_path / "b.bmp"), upright.get_pixels("uint8"))
    assert any("pixels are turned" in warning for warning in report.warnings) == (turned > 1)
    smooth_file(source, tmp_path / "b.png", iterations=0)
    np.testing.assert_array_equal(stored(tmp_path / "b.png"), noise("uint8", 3))


def test_texts_that_are_no_utf_8_do_not_bar_a_conversion():
    header, *others = png_chunks(encode(noise("uint8", 3), "png"))
    picture = read_image(png_file([header, (b"tEXt", b"Author\0Zo\xeb"), *others]), "x.png")
    assert b"Zo\xeb" in write_image(picture, picture.pixels, suffix=".jpg").data


LATIN_1 = {
    "channel": (b"Z\0", b"\xeb\0"),
    "name": (b"title\0", b"titl\xeb\0"),
    "name that is left out": (b"title\0", b"gif:\xeb\0"),
    "value": (b"Zoe", b"Zo\xeb"),
}


def latin_1_exr(what):
    """Return an EXR with a letter of Latin-1 in the name of a channel or of an attribute, or in its value."""
    pixels = np.random.default_rng(0).random((8, 8, 5), np.float32)
    data = encode(pixels, "openexr", "float", compression="none", title="Zoe")
    old, new = LATIN_1[what]
    assert old in data
    return data.replace(old, new)


@pytest.mark.parametrize("suffix", [None, ".tif", ".png", ".jpg", ".webp", ".rla"])
@pytest.mark.parametrize("what", LATIN_1)
def test_exr_files_whose_texts_are_no_utf_8_are_written_in_every_format(what, suffix):
    picture = read_image(latin_1_exr(what), "x.exr")
    written = write_image(picture, picture.pixels, suffix=suffix)
    again = read_image(written.data, f"x{suffix or '.exr'}")
    assert again.pixels.shape[:2] == (8, 8)
    if suffix is None:
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        assert again.channels == picture.channels
        assert LATIN_1[what][1] in written.data or what == "name that is left out"


def test_an_unknown_extension_is_refused():
    picture = picture_of("png", "uint8", 3)
    with pytest.raises(UsageError, match=r"\.xyz"):
        write_image(picture, picture.pixels, suffix=".xyz")


def test_a_jpeg_that_coding_would_change_more_than_the_result_stays():
    """Hues of single pixels, stored for 2 x 2 of them, are lost by far more than a step in one pixel."""
    hues = np.random.default_rng(0).random((64, 64, 3), np.float32)
    subsampled = jpeg_file(hues, 90)
    picture = read_image(subsampled, "in.jpg")
    nearly = picture.pixels.copy()
    nearly[0, 0, 0] ^= 1
    kept = write_image(picture, nearly)
    assert kept.data == subsampled
    assert kept.notices[0].startswith("in.jpg stays as it is")
    assert write_image(picture, picture.pixels // 2).data != subsampled
