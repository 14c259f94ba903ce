"""KTX2 and AVIF: read, written again as they were, taken back to plain images in glTF, refused in one line."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image, ImageCms

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image import extra_codecs, read_image, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.inspect import check_files
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from formats.gltf_comparison import EXTENSIONS, with_better_image
from formats.gltf_files import opened
from formats.image_files import encode, painting
from oracles.paintings import psnr

ONCE = KernelParameters(iterations=1, t=2, beta=20)
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], "f4")


def needs(*known):
    lacks = [package for each in known if (package := extra_codecs.missing_package(each))]
    return pytest.mark.skipif(bool(lacks), reason=f"not installed: {', '.join(lacks)}")


BOTH = [pytest.param(known, marks=needs(known)) for known in ("ktx2", "avif")]


def file_of(known, channels=3, **options):
    pixels = painting(channels)
    if options:
        import alktx2

        filled = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])[..., :4]
        return alktx2.encode_raw_rgba_to_ktx2(filled.tobytes(), 32, 32, channels == 4, **options)
    return write_image(new_picture(pixels, "x"), pixels, suffix=f".{known}").data


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("known", BOTH)
def test_what_is_written_is_read_again_and_its_cost_is_told(known, channels):
    pixels = painting(channels)
    file = write_image(new_picture(pixels, "skin"), pixels, suffix=f".{known}")
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
    profile, buffer = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(), io.BytesIO()
    exif = b"II*\0\x08\0\0\0" + bytes(6)
    Image.fromarray(painting()).save(buffer, "AVIF", icc_profile=profile, quality=90, exif=exif, xmp=b"<x/>")
    old = read_image(buffer.getvalue(), "x.avif")
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
    plain = encode(painting(), "png") if fallback else None
    source, target = (
        with_better_image(known, file_of(known), plain).written_to(tmp_path),
        tmp_path / "out.glb",
    )
    settings = SmoothSettings(kernel=ONCE, textures=TextureSettings(image_suffix=suffix))
    report = smooth_file(source, target, settings)
    tree, _, _ = opened(target)
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
    told = [each for each in report.warnings if "PSNR" in each]
    assert len(told) == (kept not in (None, "EXT_texture_webp"))
    if fallback and suffix is None:
        images = open_document(str(target)).images
        plain, better = (read_image(images.data(index), "x").pixels for index in (0, 1))
        assert psnr(plain / 255, better / 255) > psnr(painting() / 255, better / 255) + 3


@pytest.mark.parametrize("known", BOTH)
def test_without_its_package_a_texture_is_left_as_it_is_and_the_package_is_named(
    tmp_path, known, monkeypatch
):
    model = with_better_image(known, file_of(known))
    plain = model.texture(model.image(encode(painting(), "png")))
    model.triangles(SQUARE + 2, SQUARE[:, :2], model.material(baseColor=plain))
    source, image = model.written_to(tmp_path), file_of(known)
    for module in ("beltrami_cli.formats.gltf.textures", extra_codecs.__name__):
        monkeypatch.setattr(f"{module}.missing_package", lambda known: "a package")
    document = open_document(str(source))
    assert len(document.textured("baseColor").textures) == 1
    assert any("needs the package a package; install it with: pip" in each for each in document.notices)
    with pytest.raises(InputError, match=r"need the package a package; install it with: pip"):
        read_image(image, f"x.{known}")
    with pytest.raises(UsageError, match="the package a package is needed; install it with: pip"):
        write_image(new_picture(painting(), "x"), painting(), suffix=f".{known}")


HEADERS = {
    "sides": {20: 1 << 20, 24: 1 << 20},
    "no height": {24: 0},
    "depth": {28: 7},
    "layers": {32: 1 << 30},
    "a cube": {36: 6},
    "levels": {40: 1 << 31},
    "other samples": {12: 37},
    "other compression": {44: 3},
    "an offset": {80: 1 << 31},
    "a length": {88: 1 << 31},
    "an unpacked length": {96: 1 << 31},
}


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
