"""The rarer image formats, files with more in them than one plain picture, and colours that an alpha of 0 hides."""

from __future__ import annotations

import io
import struct

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

from beltrami_cli import smooth_file
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.image import check_writable, losses, read_image, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.inspect import check_files
from formats.gltf_comparison import with_better_image
from formats.image_files import encode, exact_webp, noise, png_chunks, png_file, two_pixels, with_alpha
from formats.test_extra_codecs import BOTH
from hostile.textured_models import write_model


def dds(pixels):
    """Uncompressed BGRA, as Microsoft's description of the DDS header has it."""
    height, width, _ = pixels.shape
    form = struct.pack("<8I", 32, 0x41, 0, 32, 0xFF0000, 0xFF00, 0xFF, 0xFF000000)
    header = struct.pack("<7I44x", 124, 0x100F, height, width, 4 * width, 0, 0) + form
    return b"DDS " + header + struct.pack("<5I", 0x1000, 0, 0, 0, 0) + pixels[..., [2, 1, 0, 3]].tobytes()


def psd(pixels):
    """Without layers and without compression, as Adobe's description of the Photoshop format has it."""
    height, width, channels = pixels.shape
    header = b"8BPS" + struct.pack(">H6xHIIHH", 1, channels, height, width, 8, 3)
    return header + bytes(12) + bytes(2) + np.moveaxis(pixels, 2, 0).tobytes()


def read_only():
    opaque = noise("uint8", 4)
    opaque[..., 3] = 255
    flat = np.full((5, 7, 3), 9, np.uint8)
    return {
        "x.dds": (lambda: dds(with_alpha(noise("uint8", 4))), with_alpha(noise("uint8", 4))),
        "x.psd": (lambda: psd(opaque[..., :3]), opaque[..., :3]),
        "x.ico": (lambda: encode(opaque, "ico"), opaque),
        "x.gif": (lambda: encode(flat, "gif"), np.dstack([flat, np.full((5, 7), 255, np.uint8)])),
        "x.z": (lambda: encode(noise("float", 1), "zfile"), noise("float", 1)),
    }


@pytest.mark.parametrize("name", read_only())
def test_formats_that_are_only_read_say_what_else_there_is(name):
    make, pixels = read_only()[name]
    picture = read_image(make(), name)
    np.testing.assert_array_equal(picture.pixels, pixels)
    with pytest.raises(UsageError, match=f"images cannot be written as {name[2:].upper()}; choose .png"):
        check_writable(picture, None)
    again = read_image(write_image(picture, picture.pixels, suffix=".tif").data, "x.tif")
    np.testing.assert_array_equal(again.pixels, pixels)


def test_a_format_that_this_build_lacks_is_named():
    if "heif" in OpenImageIO.get_string_attribute("input_format_list").split(","):
        pytest.skip("this build reads it")
    with pytest.raises(InputError, match="does not read HEIC"):
        read_image(bytes(4) + b"ftypheic" + bytes(20), "photo.heic")


@pytest.mark.parametrize("suffix", [".exr", ".tif"])
def test_of_mip_mapped_files_the_full_size_is_kept_and_said_so(suffix, tmp_path):
    pixels, path = noise("float", 3, 64, 64), tmp_path / f"skin{suffix}"
    OpenImageIO.ImageBufAlgo.make_texture(OpenImageIO.MakeTxTexture, OpenImageIO.ImageBuf(pixels), str(path))
    picture = read_image(path.read_bytes(), path.name)
    assert "mip levels" in picture.notices[0]
    for target in (".exr", ".tif"):  # an EXR that announces levels it does not have counts as damaged
        again = read_image(write_image(picture, picture.pixels, suffix=target).data, f"skin{target}")
        np.testing.assert_array_equal(again.pixels, pixels)
        assert not again.notices


def saved(picture, suffix=".tif", **options):
    buffer = io.BytesIO()
    picture.save(buffer, Image.registered_extensions()[suffix], **options)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("suffix", "bits", "is_transparent"),
    [(".bmp", 4, False), (".tga", 8, False), (".tif", 8, False), (".gif", 4, False)]
    + [(".png", bits, is_transparent) for bits in (1, 2, 4, 8) for is_transparent in (False, True)],
)  # fmt: skip
def test_a_palette_is_reported_and_becomes_full_colours(suffix, bits, is_transparent):
    random = np.random.default_rng(bits)
    image = Image.fromarray(random.integers(0, 1 << bits, (13, 19)).astype(np.uint8), "P")
    image.putpalette(random.integers(0, 256, 3 << bits).astype(np.uint8).tobytes())
    options = {"bits": bits, "dpi": (72, 72)} if suffix == ".png" else {}
    if is_transparent:
        options["transparency"] = bytes(random.integers(0, 256, 1 << bits).tolist())
    source = saved(image, suffix, **options)
    picture = read_image(source, f"x{suffix}")
    file = write_image(picture, picture.pixels[::-1, ::-1], suffix=".png" if suffix == ".gif" else None)
    assert any("palette" in notice for notice in (*picture.notices, *file.notices))
    with Image.open(io.BytesIO(file.data)) as new, Image.open(io.BytesIO(source)) as old:
        assert suffix != ".png" or new.info["dpi"] == pytest.approx((72, 72), abs=0.1)
        shown, expected = (np.asarray(each.convert("RGBA")).astype(int) for each in (new, old))
    # Pillow multiplies levels by 256 for the 16 bits of a TIFF, of which the full scale is 257 times 255.
    assert np.abs(shown - expected[::-1, ::-1]).max() <= (1 if suffix == ".tif" else 0)
    for kind in ("RGB", "L") if suffix != ".gif" else ():
        assert not read_image(saved(image.convert(kind), suffix), f"x{suffix}").notices


@pytest.mark.parametrize(
    ("mode", "options", "reported"),
    [
        ("YCbCr", {}, ["(YCbCr), which become red, green and blue"]),
        ("RGB", {"compression": "jpeg"}, ["compressed by jpeg; TIFF files are written with zip"]),
        ("YCbCr", {"compression": "jpeg"}, ["(YCbCr)", "compressed by jpeg"]),
        ("1", {"compression": "group4"}, ["has 1-bit samples, which become 8", "compressed by ccittfax4"]),
        ("RGB", {"compression": "tiff_lzw"}, []),
        ("RGB", {"compression": "packbits"}, []),
        ("RGB", {"compression": "tiff_adobe_deflate"}, []),
        ("RGBA", {}, []),
        ("I;16", {}, []),
    ],
)
def test_what_a_tiff_stores_otherwise_is_reported_once(mode, options, reported):
    """What is not reported comes back as it was."""
    across, down = np.meshgrid(np.arange(48), np.arange(32))
    slope = np.stack([5 * across, 7 * down, 80 + across + down], axis=2).astype(np.uint8)
    deep = Image.fromarray(slope[..., 0].astype(np.uint16))
    picture = deep if mode == "I;16" else Image.fromarray(slope).convert(mode)
    image = read_image(saved(picture, **options), "x.tif")
    assert len(image.notices) == len(reported)
    assert all(words in notice for words, notice in zip(reported, image.notices, strict=True))
    if mode == "YCbCr":
        assert np.abs(image.pixels.astype(int) - slope).max() <= (12 if options else 3)
    again = read_image(write_image(image, image.pixels).data, "x.tif")
    np.testing.assert_array_equal(again.pixels, image.pixels)
    assert not again.notices
    if not reported:
        for attribute in ("compression", "tiff:PhotometricInterpretation"):
            assert again.spec.getattribute(attribute) == image.spec.getattribute(attribute)


def test_lightness_and_hues_are_refused():
    """OpenImageIO reads the white of CIELAB as (255, 252, 222)."""
    with pytest.raises(InputError, match=r"x\.tif: its colours are CIELAB; convert it to RGB"):
        read_image(saved(Image.fromarray(noise("uint8", 3), "LAB")), "x.tif")


@pytest.mark.parametrize(("channels", "colour"), [(1, b"\0\7"), (3, b"\0\7\0\7\0\7")])
def test_a_transparent_colour_of_png_is_reported(channels, colour):
    pixels = np.full((2, 2, channels), 7, np.uint8)
    pixels[0] = 9
    header, *others = png_chunks(encode(pixels, "png"))
    picture = read_image(png_file([header, (b"tRNS", colour), *others]), "x.png")
    assert picture.pixels[..., -1].tolist() == [[255, 255], [0, 0]]
    assert picture.notices == ("x.png has a colour that is transparent, which becomes an alpha channel.",)


def test_values_that_are_not_finite_can_be_asked_for_and_stay():
    pixels = noise("float", 3)
    pixels[0, 0], pixels[1, 1, 1] = np.nan, -np.inf
    picture = read_image(encode(pixels, "openexr", "float"), "x.exr", finite=False)
    again = read_image(write_image(picture, picture.pixels).data, "x.exr", finite=False)
    np.testing.assert_array_equal(again.pixels, pixels)
    assert any("NaN becomes 0" in loss for loss in losses(picture, ".png"))
    png = read_image(write_image(picture, picture.pixels, suffix=".png").data, "x.png")
    assert png.pixels[0, 0].tolist() == [0, 0, 0]


def test_jpeg_2000_is_refused_where_it_would_be_damaged():
    picture = read_image(encode(noise("uint8", 3, 31, 40), "png"), "x.png")
    with pytest.raises(UsageError, match="fewer than 32 pixels"):
        write_image(picture, picture.pixels, suffix=".jp2")


def test_chunks_of_a_palette_go_with_it_and_are_reported():
    picture = read_image(
        two_pixels((b"tRNS", bytes([7])), (b"bKGD", bytes([1])), (b"tEXt", b"Title\0t")), "x.png"
    )
    assert picture.pixels.tolist() == [[[1, 2, 3, 7], [200, 100, 50, 255]]]
    file = write_image(picture, picture.pixels[:, ::-1])
    np.testing.assert_array_equal(read_image(file.data, "x.png").pixels, picture.pixels[:, ::-1])
    assert [kind for kind, _ in png_chunks(file.data)] == [b"IHDR", b"tEXt", b"IDAT", b"IEND"]
    assert any("PNG chunk bKGD" in notice for notice in file.notices)


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
