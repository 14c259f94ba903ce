"""JPEG files: what follows the first picture is kept or reported, and never mixed into it; tables of quantisation.

Tables are compared with what Pillow reads.
"""

from __future__ import annotations

import io
import struct
import tempfile
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

from beltrami_cli.formats.image import losses, read_image, write_image
from beltrami_cli.formats.image.metadata import read_jpeg_tables
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.surface.records import srgb_to_linear
from formats.image_files import encode

_ADOBE = "http://ns.adobe.com/xap/1.0/\0"
_GOOGLE = "http://ns.google.com/photos/1.0/container/"
_ISO = b"urn:iso:std:iso:ts:21496:-1\0"


def xmp(description, content=""):
    """Return an XMP segment whose description has these attributes and this content."""
    tree = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" '
        f'xmlns:Container="{_GOOGLE}" xmlns:Item="{_GOOGLE}item/" hdrgm:Version="1.0" {description}>'
        f"{content}</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    return segment(0xE1, f"{_ADOBE}{tree}".encode())


def segment(marker, payload):
    return bytes([0xFF, marker]) + (len(payload) + 2).to_bytes(2) + payload


def with_segments(jpeg, *segments):
    return jpeg[:2] + b"".join(segments) + jpeg[2:]


def index_of(order, length, others):
    """Return an index of pictures: the length of the first, and lengths and offsets of the others."""
    size = 16 * (1 + len(others))
    fields = [(0xB000, 7, 4, int.from_bytes(b"0100", "little" if order == "<" else "big"))]
    fields += [(0xB001, 4, 1, 1 + len(others)), (0xB002, 7, size, 50)]
    entries = [(0x030000, length, 0), *((0, *other) for other in others)]
    payload = b"MPF\0" + (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, 3)
    payload += b"".join(struct.pack(f"{order}HHII", *field) for field in fields) + bytes(4)
    return segment(0xE2, payload + b"".join(struct.pack(f"{order}IIIHH", *entry, 0, 0) for entry in entries))


def joined(first, others, order="<"):
    """Put pictures into one file, with an index in front."""
    room = len(index_of(order, 0, [(0, 0)] * len(others)))
    length, places = len(first) + room, []
    for other in others:
        # Offsets count from the byte order mark: behind the start of the file, a marker, a length and "MPF".
        places.append((len(other), length + sum(size for size, _ in places) - (2 + 4 + 4)))
    return with_segments(first, index_of(order, length, places)) + b"".join(others)


def photograph():
    """Return smooth colours with noise."""
    rows, columns = np.mgrid[:64, :64] * 3
    plain = np.stack([rows, columns, 120 + (rows - columns) // 2], axis=-1)
    return np.clip(plain + np.random.default_rng(1).normal(0, 5, plain.shape), 0, 255).astype(np.uint8)


def gain_map():
    """Return a gain map that makes a picture up to four times as bright."""
    grey = np.tile(np.linspace(40, 240, 32).astype(np.uint8), (32, 1))[..., None]
    curve = (
        'hdrgm:GainMapMin="0" hdrgm:GainMapMax="2" hdrgm:Gamma="1" hdrgm:OffsetSDR="0.015625" '
        'hdrgm:OffsetHDR="0.015625" hdrgm:HDRCapacityMin="0" hdrgm:HDRCapacityMax="2" '
        'hdrgm:BaseRenditionIsHDR="False"'
    )
    return with_segments(encode(grey, "jpeg", compression="jpeg:90"), xmp(curve))


def ultra_hdr(order="<"):
    """Return a photograph with a gain map, as phones make it."""
    gain = gain_map()
    items = (
        '<rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="Primary" Item:Mime="image/jpeg"/></rdf:li>'
        '<rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="GainMap" Item:Mime="image/jpeg" '
        f'Item:Length="{len(gain)}"/></rdf:li>'
    )
    container = xmp("", f"<Container:Directory><rdf:Seq>{items}</rdf:Seq></Container:Directory>")
    plain = encode(photograph(), "jpeg", compression="jpeg:95")
    return joined(with_segments(plain, container, segment(0xE2, _ISO + bytes(4))), [gain], order)


def as_openimageio_reads(data):
    """Return the channels, the type and the mean of a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.jpg"
        path.write_bytes(data)
        file = OpenImageIO.ImageInput.open(str(path))
        return file.spec().nchannels, str(file.spec().format), file.read_image("float")[..., :3].mean()


def pictures_of(data):
    """Return all pictures of a file, found by its index."""
    with Image.open(io.BytesIO(data)) as file:
        found = []
        for number in range(getattr(file, "n_frames", 1)):
            file.seek(number)
            found.append(np.asarray(file.convert("RGB")))
        return found


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_gain_map_is_kept_and_not_applied(order):
    source = ultra_hdr(order)
    picture = read_image(source, "x.jpg")
    assert (picture.stored, picture.pixels.shape, picture.notices) == ("uint8", (64, 64, 3), ())
    assert np.abs(picture.pixels.mean() - photograph().mean()) < 1
    size = measure_image(source, "x.jpg")
    assert (size.channels, size.sample) == (3, 1)
    new = write_image(picture, picture.pixels // 2 + 60).data
    assert new.endswith(gain_map())
    assert new.count(b"Item:Length") == new.count(_ISO) == 1
    before, after = as_openimageio_reads(source), as_openimageio_reads(new)
    if before[:2] == (3, "uint8"):
        pytest.skip("this build of OpenImageIO does not read gain maps")
    assert before[:2] == after[:2] == (4, "half")
    light = srgb_to_linear((picture.pixels // 2 + 60) / np.float32(255))
    assert after[2] > 1.1 * light.mean()  # since the map was found and applied


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("quality", [30, 98])  # smaller and larger than the source
def test_the_index_finds_all_pictures_again(order, quality):
    others = [encode(np.full((16, 16, 3), level, np.uint8), "jpeg") for level in (50, 200)]
    source = joined(encode(photograph(), "jpeg", compression="jpeg:80"), others, order)
    assert len(pictures_of(source)) == 3
    picture = read_image(source, "x.jpg")
    new = write_image(picture, picture.pixels[::-1], jpeg_quality=quality).data
    first, *further = pictures_of(new)
    np.testing.assert_array_equal(first, read_image(new, "x.jpg").pixels)
    assert [round(each.mean()) for each in further] == [50, 200]
    assert struct.unpack_from(f"{order}I", new, new.index(b"MPF\0") + 4 + 54)[0] == len(new) - sum(
        map(len, others)
    )


@pytest.mark.parametrize("suffix", [".png", ".tif", ".exr", ".webp", ".jp2"])
def test_other_formats_report_the_loss_and_claim_no_gain_map(suffix):
    picture = read_image(ultra_hdr(), "x.jpg")
    assert any("what follows it in the JPEG file is dropped" in notice for notice in losses(picture, suffix))
    new = write_image(picture, picture.pixels, suffix=suffix).data
    assert not any(word in new for word in (b"hdrgm", b"GainMap", _ISO))
    assert not losses(read_image(encode(photograph(), "jpeg"), "x.jpg"), ".png")


@pytest.mark.parametrize("damage", [b"MPF\0II*\0\xff\xff\xff\xff", b"MPF\0", b"MPF\0II*\0\x08\0\0\0\0\0"])
def test_an_index_that_cannot_be_read_stays_as_it_is(damage):
    source = with_segments(encode(photograph(), "jpeg"), segment(0xE2, damage)) + b"video"
    picture = read_image(source, "x.jpg")
    new = write_image(picture, picture.pixels // 2).data
    assert segment(0xE2, damage) in new
    assert new.endswith(b"\xff\xd9video")


@pytest.mark.parametrize("progressive", [0, 1])
def test_the_end_of_a_picture_is_found_behind_all_its_scans(progressive):
    plain = encode(photograph(), "jpeg", jpeg__progressive=progressive)
    picture = read_image(plain + b"\xff\xd8\xff", "x.jpg")
    assert write_image(picture, 255 - picture.pixels).data.count(b"\xff\xd9\xff\xd8\xff") == 1
    np.testing.assert_array_equal(picture.pixels, read_image(plain, "x.jpg").pixels)


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


def test_a_grey_picture_has_one_table_and_other_colours_than_luma_and_chroma_have_none():
    found = read_jpeg_tables(saved(mode="L", quality=80))
    assert (found.steps.shape, found.span) == ((1, 8, 8), (1, 1))
    for data in (saved(mode="CMYK"), saved(keep_rgb=True)):
        assert read_jpeg_tables(data) is None


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
