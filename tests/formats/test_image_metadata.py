"""Every tag, chunk, segment and attribute of an image is in the file that is written from it, or named as lost."""

import io
import re
import struct
from functools import partial

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

from beltrami_cli.formats.image.metadata import carry_over
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from formats.image_files import (
    SUFFIXES,
    bitmap,
    encode,
    icc_profile,
    jpeg_segment,
    noise,
    png_chunks,
    png_file,
    riff,
    riff_chunks,
    saved,
)
from formats.tiff_files import described, exr_attributes, exr_file, tiff_file, tiff_tags

_TEXT = [*b"some words\0"]
# What GDAL writes: scale, tie point, keys with their numbers and texts, and what stands for no data.
_GEOREFERENCE = {
    33550: (12, [0.5, 0.5, 0.0]), 33922: (12, [0, 0, 0, 500000.0, 4649776.25, 0]),
    34735: (3, [1, 1, 0, 1, 1024, 0, 1, 1]),
    34736: (12, [6378137.0, 298.257]), 34737: (2, [*b"WGS 84|\0"]), 42112: (2, [*b"<GDALMetadata/>\0"]),
    42113: (2, [*b"-9999\0"]),
}  # fmt: skip
_TEXTS = {
    270: (2, _TEXT),
    274: (3, [6]), 282: (5, [72, 1]), 283: (5, [300, 7]), 296: (3, [3]), 315: (2, _TEXT),
}  # fmt: skip
_BLOCKS = {
    700: (1, [*b"<x:xmpmeta/>"]),
    33723: (7, [28, 2, 120, 0, 1, 65]),
    34377: (1, [*b"8BIM"]),
    34675: (7, [*icc_profile()]),
}
_PRIVATE = {
    65000 + kind: (kind, values)
    for kind, values in {
        1: [1, 2, 3, 4, 5], 2: _TEXT, 3: [1, 65535, 7], 4: [1 << 31, 5], 5: [1, 3, 5, 7], 6: [-1, 2], 7: [9] * 9,
        8: [-300, 5], 9: [-70000, 4], 10: [-1, 3], 11: [0.5, -2.0], 12: [1e300],
    }.items()
}  # fmt: skip
_EXIF = {
    33434: (5, [1, 100]),
    36867: (2, _TEXT),
    37500: (7, [*b"maker's own notes"]),
    40965: (4, {1: (2, [*b"R98\0"])}),
}
_DIRECTORIES = {
    34665: (4, _EXIF),
    34853: (4, {1: (2, [78, 0]), 2: (5, [1, 1, 2, 1, 3, 1])}),
    65100: (13, {5: (3, [7])}),
}
_ALL = {**_TEXTS, **_BLOCKS, **_GEOREFERENCE, **_PRIVATE, **_DIRECTORIES}


def rewritten(data, name):
    image = read_image(data, name)
    pixels = image.pixels[::-1].copy()
    file = write_image(image, pixels)
    np.testing.assert_array_equal(read_image(file.data, name).pixels, pixels)
    assert file.data == write_image(image, pixels).data
    return file


@pytest.mark.parametrize(("order", "is_big"), [("<", False), (">", False), ("<", True), (">", True)])
def test_every_tag_of_a_tiff_is_kept_and_none_is_added(order, is_big):
    kinds = {65016: (16, [1 << 40, 3]), 65017: (17, [-1])} if is_big else {}
    source = tiff_file(noise("uint8", 3), {**_ALL, **kinds}, order, is_big=is_big)
    file = rewritten(source, "x.tif")
    assert described(file.data) == described(source)
    assert not file.notices
    assert (file.data[2:3] == b"+") == is_big


def _nested(depth):
    return {34665: (4, _nested(depth - 1))} if depth else {1: (1, [1])}


@pytest.mark.parametrize(
    ("tags", "named"),
    [
        ({330: (4, {256: (4, [1]), 273: (4, [8])})}, "TIFF tag 330 (further images)"),
        ({37724: (7, [1, 2, 3, 4, 5])}, "TIFF tag 37724 (layers of Photoshop)"),
        ({65000: (99, [1, 2, 3])}, "TIFF tag 65000"),
        ({65000: (16, [1])}, "TIFF tag 65000"),
        ({34665: (4, [1 << 30])}, "TIFF tag 34665 (EXIF)"),
        ({34665: (4, _nested(6))}, "TIFF tag 34665 (EXIF)"),
        ({280: (3, [3]), 281: (3, [200])}, "TIFF tag 280, TIFF tag 281"),  # ranges, which new colours may leave
    ],
)  # fmt: skip
def test_tags_that_cannot_be_kept_are_named(tags, named):
    source = tiff_file(noise("uint8", 3), {**_GEOREFERENCE, **tags})
    file = rewritten(source, "x.tif")
    assert file.notices == (f"x.tif: these metadata are not kept in TIF: {named}.",)
    assert described(file.data) == described(tiff_file(noise("uint8", 3), _GEOREFERENCE))


def test_iptc_are_bytes_even_if_they_are_called_long_numbers():
    iptc = b"\x1c\2\x78\0\1A\0\0"
    source = tiff_file(noise("uint8", 3), {33723: (4, [*struct.unpack(">2I", iptc)])}, ">")
    assert iptc in source
    assert iptc in rewritten(source, "x.tif").data


def test_a_directory_that_contains_itself_is_named():
    source = bytearray(tiff_file(noise("uint8", 3), {34665: (4, {1: (1, [1])}), **_GEOREFERENCE}))
    (first,) = struct.unpack_from("<I", source, 4)
    entry = source.index(struct.pack("<HH", 34665, 4), first)
    struct.pack_into("<I", source, entry + 8, first)
    assert "34665" in rewritten(bytes(source), "x.tif").notices[0]


_EXR = {
    "owner": ("string", b"me"), "capDate": ("string", b"2003:06:12 00:00:00"), "an int": ("int", bytes(4)),
    "double": ("double", bytes(8)), "rational": ("rational", struct.pack("<iI", 1, 24)),
    "preview": ("preview", struct.pack("<ii", 1, 1) + bytes(4)), "box": ("box2f", bytes(16)),
    "matrix": ("m33f", bytes(36)), "words": ("stringvector", struct.pack("<i", 2) + b"ab"),
    "private": ("somebody's", bytes(range(40))), "latin": ("string", b"caf\xe9"), "empty": ("string", b""),
    "a name of more than thirty-one characters": ("float", bytes(4)), "code": ("timecode", bytes(8)),
}  # fmt: skip


def planes(*names, kind=np.float16, size=(9, 7)):
    rng = np.random.default_rng(len(names))
    return {name: rng.random(size).astype(kind) for name in names}


@pytest.mark.parametrize("extra", [_EXR, {}])
def test_every_attribute_of_an_exr_is_kept_and_none_is_added(extra):
    source = exr_file(planes("R", "G", "B"), extra)
    file = rewritten(source, "x.exr")
    assert exr_attributes(file.data) == exr_attributes(source)
    assert file.data[:8] == source[:8]  # version, and whether names are long
    assert not file.notices
    face = exr_file(
        planes("R", "G", "B"), {"displayWindow": ("box2i", bytes(16))}
    )  # as of a cube with mip levels
    assert exr_attributes(carry_over(source, face, "openexr")) == exr_attributes(source)


_SMALL_EXIF = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"  # orientation


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_every_chunk_of_a_png_is_kept_in_its_place_or_named(kind):
    header, *others = png_chunks(encode(noise(kind, 3), "png"))
    pixels = [chunk for chunk in others if chunk[0] == b"IDAT"]
    before = [
        (b"gAMA", (45455).to_bytes(4)), (b"pHYs", bytes([0, 0, 11, 19, 0, 0, 11, 19, 1])), (b"tEXt", b"Author\0me"),
        (b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0<x/>"), (b"eXIf", _SMALL_EXIF), (b"prVt", b"private"),
        (b"sBIT", bytes([5, 6, 5])),
    ]  # fmt: skip
    behind = [(b"tEXt", b"Comment\0at the end"), (b"IEND", b"")]
    source = png_file([header, *before, *pixels, *behind])
    written = png_chunks(rewritten(source, "x.png").data)
    at = len(before) + 1
    assert written[:at] == [header, *before]
    assert written[-len(behind) :] == behind
    assert {name for name, _ in written[at : -len(behind)]} == {b"IDAT"}
    file = write_image(read_image(source, "x.png"), noise(kind, 3), suffix=".tif")
    assert file.notices == ("x.png: these metadata are not kept in TIF: PNG chunk prVt, PNG chunk sBIT.",)


@pytest.mark.parametrize(("channels", "compression"), [(3, "lossless"), (4, "lossless"), (3, "webp:90")])
def test_every_chunk_of_a_webp_is_kept(channels, compression):
    plain = encode(noise("uint8", channels, 9, 12), "webp", compression=compression)
    coded = [chunk for chunk in riff_chunks(plain) if chunk[0] != b"VP8X"]
    behind = [(b"EXIF", _SMALL_EXIF), (b"XMP ", b"<x/>"), (b"PRIV", b"some"), (b"PRIV", b"more")]
    flags = 0x3C if channels == 4 else 0x2C
    before = [(b"VP8X", bytes([flags, 0, 0, 0, 11, 0, 0, 8, 0, 0])), (b"ICCP", icc_profile())]
    image = read_image(riff([*before, *coded, *behind]), "x.webp")
    file = write_image(image, image.pixels[::-1])
    written = riff_chunks(file.data)
    assert (written[:2], written[-4:]) == (before, behind)
    assert {name for name, _ in written[2:-4]} <= {b"VP8L", b"VP8 ", b"ALPH"}
    reported = [bool(re.search(r"a PSNR of \d+\.\d dB", notice)) for notice in file.notices]
    assert reported == ([] if compression == "lossless" else [True])


def test_every_segment_of_a_jpeg_is_kept_in_its_place():
    plain = encode(np.full((16, 16, 3), 99, np.uint8), "jpeg", compression="jpeg:95")
    payloads = {
        0xE1: b"Exif\0\0" + _SMALL_EXIF, 0xE2: b"ICC_PROFILE\0\x01\x01" + icc_profile(),
        0xE3: b"http://ns.adobe.com/xap/1.0/\0<x/>", 0xE4: b"MPF\0" + bytes(9), 0xEB: b"JP\0\1jumb",
        0xED: b"Photoshop 3.0\0", 0xFE: b"hi",
    }  # fmt: skip
    jfif = plain.index(b"\xff\xe0")
    behind = jfif + 2 + int.from_bytes(plain[jfif + 2 : jfif + 4])
    kept = [jpeg_segment(marker, payload) for marker, payload in payloads.items()]
    head = plain[:behind] + b"".join(kept)
    image = read_image(head + plain[behind:], "x.jpeg")
    file = write_image(image, image.pixels // 2)
    assert file.data.startswith(head)
    assert [file.data.count(each) for each in kept] == [1] * len(kept)
    assert (file.notices, file.suffix) == ((), ".jpeg")


_FLOATS = b"PF\n# a comment\n7 5\n-0.25\n"  # with a scale
_BITMAP, _TARGA = bitmap(0xFF0000, 0xFF00, 0xFF, 0xFF000000), bytearray(encode(noise("uint8", 4), "targa"))
_TARGA[17] &= 0xF0  # 32 bits, and none is said to be alpha


def targa(order, coding):
    """A TGA file whose first row is the lowest (-1) or the top one (1), plain or in runs."""
    return saved(Image.fromarray(noise("uint8", 3)), ".tga", orientation=order, compression=coding)


_PLACES = {
    "x.hdr": (lambda: encode(noise("float", 3) ** 2, "hdr").replace(b"\n\n", b"\n# a comment\nVIEW= -vp 1\n\n", 1),
              [b"# a comment\n", b"VIEW= -vp 1\n"]),
    "x.ppm": (lambda: b"P6\n# a comment\n7 5 # another\n255\n" + bytes(range(105)) + b"P6 1 1 255 RGB",
              [b"# a comment\n", b"# another\n", b"P6 1 1 255 RGB"]),
    "x.pfm": (lambda: _FLOATS + noise("float", 3).tobytes(), [_FLOATS]),
    "x.bmp": (lambda: _BITMAP, [_BITMAP[:138], b"a profile"]),
    "x.tga": (lambda: _TARGA, [_TARGA[:18]]),
    **{f"{order}{coding}.tga": (partial(targa, order, coding), [targa(order, coding)[:18]])
       for order in (-1, 1) for coding in (None, "tga_rle")},
    "x.png": (lambda: encode(noise("uint8", 3), "png") + b"some tEXt", [b"some tEXt"]),
    "x.webp": (lambda: encode(noise("uint8", 3), "webp", compression="lossless") + b"a RIFF chunk", [b"a RIFF chunk"]),
}  # fmt: skip


@pytest.mark.parametrize("name", _PLACES)
def test_all_in_and_behind_an_image_that_is_no_pixel_is_kept(name):
    source, kept = _PLACES[name]
    file = rewritten(bytes(source()), name)
    assert [file.data.count(each) for each in kept] == [1] * len(kept)
    assert not file.notices


def test_numbers_of_pfm_files_that_do_not_change_keep_their_bits():
    source = _FLOATS.replace(b"-0.25", b"-0.3") + noise("float", 3).tobytes()
    image = read_image(source, "x.pfm")
    assert write_image(image, image.pixels).data == source


@pytest.mark.parametrize("comment", [None, "by me"])
def test_boxes_and_comments_of_jpeg_2000_are_named(comment):
    options = {"comment": comment} if comment else {}
    data = saved(Image.fromarray(noise("uint8", 3, 40, 40)), ".jp2", **options)
    at, end = data.index(b"jp2h"), data.index(b"jp2c") - 4
    resolution = b"\0\0\0\x1ares \0\0\0\x12resc" + bytes([0, 1, 0, 1] * 2 + [0, 0])
    header = (end - at + 30).to_bytes(4) + data[at:end] + resolution
    image = read_image(data[: at - 4] + header + data[end:], "x.jp2")
    lost = "box res, comment" if comment else "box res"
    notice = f"x.jp2: these metadata are not kept in TIF: {lost}."
    assert write_image(image, image.pixels, suffix=".tif").notices == (notice,)


def exif_file(suffix):
    exif = tiff_file(noise("uint8", 3), {**_TEXTS, **_DIRECTORIES})
    if suffix == ".tif":
        return exif
    tags, options = Image.Exif(), {"lossless": True} if suffix == ".webp" else {}
    tags.load(exif)
    return saved(Image.fromarray(noise("uint8", 3, 16, 16)), suffix, exif=tags.tobytes(), **options)


def exif_in(data, suffix):
    block = data if suffix == ".tif" else Image.open(io.BytesIO(data)).info["exif"].removeprefix(b"Exif\0\0")
    return {tag: value for tag, value in tiff_tags(block).items() if tag in {*_TEXTS, 34665, 34853}}


_WITH_EXIF = [".jpg", ".png", ".tif", ".webp"]


@pytest.mark.parametrize("target", _WITH_EXIF)
@pytest.mark.parametrize("source", _WITH_EXIF)
def test_all_of_exif_goes_along_to_formats_that_have_a_place_for_it(source, target):
    data = exif_file(source)
    image = read_image(data, f"x{source}")
    file = write_image(image, image.pixels // 2, suffix=None if target == source else target)
    assert exif_in(file.data, target).items() >= exif_in(data, source).items()
    # TIFF may have directories that EXIF does not know.
    others = [notice for notice in file.notices if "not exact" not in notice]
    assert all("TIFF tag 65100" in notice for notice in others)
    assert bool(others) == (source == ".tif" != target)


@pytest.mark.parametrize("target", sorted({*SUFFIXES.values()} - {*_WITH_EXIF}))
@pytest.mark.parametrize("source", _WITH_EXIF)
def test_what_another_format_does_not_hold_is_named(source, target):
    image = read_image(exif_file(source), f"x{source}")
    file = write_image(image, image.pixels, suffix=target)
    names = {each.name.lower() for each in read_image(file.data, f"x{target}").spec.extra_attribs}
    said = " ".join(file.notices)
    texts = ("Artist", "ImageDescription", "Exif:DateTimeOriginal", "ExposureTime", "GPS:Latitude")
    expected = [each for each in texts if image.spec.getattribute(each) is not None]
    assert len(expected) >= 4
    assert all((each.lower() in names) != (each in said) for each in expected)
    assert "37500" in said


@pytest.mark.parametrize("known", sorted(SUFFIXES))
def test_an_image_without_metadata_gets_none_and_loses_none(known):
    kind = "float" if known in ("openexr", "hdr") else "uint8"
    data = exr_file(planes("R", "G", "B")) if known == "openexr" else encode(noise(kind, 3) ** 2, known, kind)
    if known == "tiff":
        data = tiff_file(noise("uint8", 3), {})
    image = read_image(data, "x" + SUFFIXES[known])
    for target in SUFFIXES.values():
        file = write_image(image, image.pixels, suffix=target)
        assert not [notice for notice in file.notices if "metadata" in notice]
        # HDR files say how they are turned, which EXIF data then repeat.
        assert known == "hdr" or not any(word in file.data for word in (b"EXIF", b"CreateDate"))
        assert target != ".tif" or 306 not in tiff_tags(file.data)  # the date


def test_damaged_metadata_are_reported():
    source = bytearray(tiff_file(noise("uint8", 3), _GEOREFERENCE))
    image = read_image(bytes(source), "x.tif")
    object.__setattr__(image, "content", bytes(source[:20]))
    assert "damaged" in write_image(image, image.pixels // 2).notices[0]
    assert OpenImageIO.geterror() == ""
