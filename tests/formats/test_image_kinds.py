"""The rarer image formats, files with more in them than one plain image, and colours that an alpha of 0 hides.

KTX2 and AVIF: read, written again as they were, taken back to plain images in glTF, refused in one line.
"""

import io
import struct

import numpy as np
import OpenImageIO
import pytest
from PIL import Image, ImageCms

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image import extra_codecs
from beltrami_cli.formats.image.conversion import conversion_losses
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.image.writing import check_writable, write_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from formats.gltf_comparison import EXTENSIONS, image_bytes, with_better_image
from formats.gltf_files import opened
from formats.image_files import (
    encode,
    exact_webp,
    noise,
    phantom,
    png_chunks,
    png_file,
    saved,
    two_pixels,
    with_alpha,
)
from hostile.textured_models import write_model
from oracles.pictures import psnr

ONCE = KernelParameters(iterations=1, t=2, beta=20)
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], "f4")


def needs(*known):
    lacks = [package for each in known if (package := extra_codecs.missing_package(each))]
    return pytest.mark.skipif(bool(lacks), reason=f"not installed: {', '.join(lacks)}")


BOTH = [pytest.param(known, marks=needs(known)) for known in ("ktx2", "avif")]


def file_of(known, channels=3, **options):
    pixels = phantom(channels)
    if options:
        import alktx2

        filled = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])[..., :4]
        return alktx2.encode_raw_rgba_to_ktx2(filled.tobytes(), 32, 32, channels == 4, **options)
    return write_image(new_image(pixels, "x"), pixels, suffix=f".{known}").data


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("known", BOTH)
def test_what_is_written_is_read_again_and_its_cost_is_told(known, channels):
    pixels = phantom(channels)
    file = write_image(new_image(pixels, "skin"), pixels, suffix=f".{known}")
    again = read_image(file.data, f"skin.{known}")
    assert (again.format, again.pixels.shape, file.suffix) == (known, pixels.shape, f".{known}")
    size = measure_image(file.data)
    assert (size.width, size.height, size.channels) == (32, 32, channels)
    reached = psnr(again.pixels[..., :3] / 255, pixels[..., :3] / 255)
    assert reached > 30
    assert f"PSNR of {reached:.1f} dB" in file.notices[0]
    assert "not exact" in file.notices[0]


@needs("ktx2")
@pytest.mark.parametrize("codec", ["etc1s", "uastc"])
@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("mipmaps", [False, True])
def test_a_ktx2_image_keeps_its_codec_its_transfer_function_and_its_mip_levels(codec, linear, mipmaps):
    import alktx2

    source = file_of("ktx2", codec=codec, linear=linear, srgb=not linear, mipmaps=mipmaps)
    old = read_image(source, "x.ktx2")
    new = write_image(old, old.pixels // 2).data
    assert alktx2.inspect_ktx2(new) == alktx2.inspect_ktx2(source)
    levels = int.from_bytes(new[40:44], "little")
    smallest, _ = alktx2.decode_ktx2_to_bytes(new, format="tga", level=levels - 1)
    mean = np.frombuffer(smallest, np.uint8, offset=18).reshape(-1, 4)[:, 2::-1].mean(axis=0)
    assert np.abs(mean - old.pixels.mean(axis=(0, 1)) / 2).max() < 20  # of the new colours, not the old ones


@needs("avif")
def test_metadata_stay_in_avif_and_are_named_where_they_are_lost():
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    exif = b"II*\0\x08\0\0\0" + bytes(6)
    options = {"icc_profile": profile, "quality": 90, "exif": exif, "xmp": b"<x/>"}
    old = read_image(saved(Image.fromarray(phantom()), ".avif", **options), "x.avif")
    for suffix in (None, ".png"):
        file = write_image(old, old.pixels // 2, suffix=suffix)
        new = read_image(file.data, "x")
        assert bytes(np.asarray(new.spec.getattribute("ICCProfile"), np.uint8)) == profile
        lost = [notice for notice in file.notices if "metadata" in notice]
        assert lost == (["x.avif: these metadata are not kept in PNG: EXIF, XMP."] if suffix else [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "fallback"),
    [(None, False), (None, True), (".png", True), (".webp", True), (".ktx2", False), (".avif", True)],
)
@pytest.mark.parametrize("known", BOTH)
def test_the_extension_of_a_texture_follows_the_image_that_is_written(tmp_path, known, fallback, suffix):
    if suffix == ".ktx2" and extra_codecs.missing_package("ktx2"):
        pytest.skip("not installed: alktx2")
    plain = encode(phantom(), "png") if fallback else None
    source = with_better_image(known, file_of(known), plain).written_to(tmp_path)
    target = tmp_path / "out.glb"
    settings = SmoothSettings(kernel=ONCE, textures=TextureSettings(image_suffix=suffix))
    report = smooth_file(source, target, settings)
    tree, buffers, _ = opened(target)
    (texture,) = tree["textures"]
    written = suffix or (".png" if fallback else f".{known}")
    own = {".webp": "EXT_texture_webp", ".ktx2": "KHR_texture_basisu", ".avif": "EXT_texture_avif"}.get(
        written
    )
    kept = EXTENSIONS[known] if fallback and suffix is None else own
    assert ("source" in texture) == (own is None)
    assert list(texture.get("extensions", {})) == ([] if kept is None else [kept])
    assert tree.get("extensionsUsed") == (None if kept is None else [kept])
    assert tree.get("extensionsRequired") == (None if own is None else [own])
    (shown,) = open_document(str(target)).textured("baseColor").textures
    assert read_image(shown.data, "x").suffix in (written, ".jpg")
    assert check_files(source, target).faithful
    reported = [each for each in report.warnings if "PSNR" in each]
    assert len(reported) == (kept not in (None, "EXT_texture_webp") or suffix == ".webp")
    if fallback and suffix is None:
        both = (image_bytes(tree, buffers, {}, index) for index in (0, 1))
        plain, better = (read_image(data, "x").pixels for data in both)
        assert psnr(plain / 255, better / 255) > psnr(phantom() / 255, better / 255) + 3


@pytest.mark.parametrize("known", BOTH)
def test_without_its_package_a_texture_is_left_as_it_is_and_the_package_is_named(
    tmp_path, known, monkeypatch
):
    model = with_better_image(known, file_of(known))
    plain = model.texture(model.image(encode(phantom(), "png")))
    model.triangles(SQUARE + 2, SQUARE[:, :2], model.material(baseColor=plain))
    source, image = model.written_to(tmp_path), file_of(known)
    for module in ("beltrami_cli.formats.gltf.images", extra_codecs.__name__):
        monkeypatch.setattr(f"{module}.missing_package", lambda known: "a package")
    document = open_document(str(source))
    surface = document.textured("baseColor")
    assert len(surface.textures) == 1
    assert any("needs the package a package; install it with: " in each for each in surface.notices)
    with pytest.raises(InputError, match=r"need the package a package; install it with: .*pip install"):
        read_image(image, f"x.{known}")
    with pytest.raises(UsageError, match=r"the package a package is needed; install it with: .*pip install"):
        write_image(new_image(phantom(), "x"), phantom(), suffix=f".{known}")


HEADERS = {
    "sides": {20: 1 << 20, 24: 1 << 20}, "no height": {24: 0}, "depth": {28: 7}, "layers": {32: 1 << 30},
    "a cube": {36: 6}, "levels": {40: 1 << 31}, "other samples": {12: 37}, "other compression": {44: 3},
    "an offset": {80: 1 << 31}, "a length": {88: 1 << 31}, "an unpacked length": {96: 1 << 31},
}  # fmt: skip


@needs("ktx2")
@pytest.mark.parametrize("lie", HEADERS)
def test_headers_of_ktx2_that_promise_too_much_are_refused_before_decoding(lie):
    data = bytearray(file_of("ktx2"))
    for at, value in HEADERS[lie].items():
        data[at : at + 4] = value.to_bytes(4, "little")
    assert measure_image(bytes(data), "bad.ktx2") is None
    with pytest.raises(InputError, match=r"^bad\.ktx2: [^\n]*$"):
        read_image(bytes(data), "bad.ktx2")


@needs("ktx2")
def test_keys_of_ktx2_that_are_lost_are_named():
    data = file_of("ktx2").replace(b"KTXwriter\0", b"licensing\0")
    picture = read_image(data, "x.ktx2")
    for suffix, label in ((None, "KTX2"), (".png", "PNG")):
        notices = write_image(picture, picture.pixels // 2, suffix=suffix).notices
        assert f"x.ktx2: these metadata are not kept in {label}: KTX2 key licensing." in notices
    plain = read_image(file_of("ktx2"), "x.ktx2")
    assert not any("metadata" in notice for notice in write_image(plain, plain.pixels // 2).notices)


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
    with pytest.raises(UsageError, match=f"images cannot be written as {name[2:].upper()}; choose .tif"):
        check_writable(picture, None)
    again = read_image(write_image(picture, picture.pixels, suffix=".tif").data, "x.tif")
    np.testing.assert_array_equal(again.pixels, pixels)


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
    file = write_image(
        picture, picture.pixels[::-1, ::-1], suffix=".png" if suffix in (".gif", ".bmp") else None
    )
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
    image = read_image(saved(picture, ".tif", **options), "x.tif")
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
    assert any("NaN becomes 0" in loss for loss in conversion_losses(picture, ".png"))
    png = read_image(write_image(picture, picture.pixels, suffix=".png").data, "x.png")
    assert png.pixels[0, 0].tolist() == [0, 0, 0]


@pytest.mark.parametrize("kind", ["palette", "16 bits", "OS/2"])
def test_rare_kinds_of_bmp_are_read_and_not_written(kind):
    image = Image.fromarray(noise("uint8", 3))
    plain = saved(image, ".bmp")
    made = {
        "palette": saved(image.quantize(16), ".bmp"),
        "16 bits": plain[:28] + b"\x10" + plain[29:54] + bytes(16 * 5),
        "OS/2": b"BM" + bytes(8) + struct.pack("<IIHHHH", 26, 12, 7, 5, 1, 24) + plain[54:],
    }
    picture = read_image(made[kind], "x.bmp")
    for suffix in (None, ".bmp", ".dib"):
        with pytest.raises(
            UsageError, match=r"x\.bmp: images cannot be written as BMP with a palette.*; choose \.tif"
        ):
            check_writable(picture, suffix)
    again = read_image(write_image(picture, picture.pixels, suffix=".png").data, "x.png")
    np.testing.assert_array_equal(again.pixels, picture.pixels)


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
    written = write_image(new_image(pixels, "x"), pixels, suffix=f".{known}")
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
