"""Image files with several images: one holds the colours, and all others stay bit for bit.

Layers and parts of EXR files, and what follows the first image of a JPEG file, whose tables of quantisation are read.
"""

import io
import json
import struct
import tempfile
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

from beltrami_cli import smooth_file
from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.conversion import conversion_losses
from beltrami_cli.formats.image.jpeg_tables import read_jpeg_tables
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.surface.colour_values import srgb_to_linear
from cli.commands import beltrami
from formats.image_files import encode, jpeg_segment, phantom, saved
from formats.tiff_files import exr_file

SIDE = 24
KERNEL = {"beta": 1.0, "t": 2.0, "iterations": 1}


def layer(name, letters, kind=np.float16, seed=0):
    rng = np.random.default_rng([seed, len(name)])
    prefix = f"{name}." if name else ""
    return {
        f"{prefix}{letter}": (0.5 + 0.1 * rng.standard_normal((SIDE, SIDE))).astype(kind)
        for letter in letters
    }


def opaque(channels):
    return channels | {name: np.ones_like(plane) for name, plane in channels.items() if name.endswith("A")}


def half_seen(channels):
    channels = opaque(channels)
    next(plane for name, plane in channels.items() if name.endswith("A"))[:4] = 0
    return channels


def stored(path, part=0):
    """Return the channels of a part as OpenImageIO reads them, by their names."""
    file = OpenImageIO.ImageInput.open(path)
    spec = file.spec(part, 0)
    pixels = file.read_image(part, 0, 0, spec.nchannels, "float")
    return dict(zip(spec.channelnames, np.moveaxis(pixels, 2, 0), strict=True))


def bits(plane):
    return np.ascontiguousarray(plane, np.float32).view(np.uint32)


def smoothed(tmp_path, planes, **options):
    """Smooth a file of these channels; return what it has afterwards, and the warnings."""
    source, target = tmp_path / "in.exr", tmp_path / "out.exr"
    source.write_bytes(exr_file(planes))
    target.unlink(missing_ok=True)
    report = smooth_file(source, target, **(KERNEL | options))
    return stored(str(target)), report.warnings


DEPTH = layer("View.Depth", "Z", np.float32) | layer("View.Normal", "XYZ") | layer("View.Mist", "Z")
LAYERED = {
    "final": ("View.Combined", half_seen(layer("View.Combined", "RGBA")) | DEPTH | layer("View.Albedo", "RGB")),
    "beauty": ("beauty", layer("beauty", "rgb") | layer("diffuse", "rgb")),
    "the only image": ("View.Noisy", layer("View.Noisy", "RGB") | DEPTH),
    "outside of layers": ("", opaque(layer("", "RGBA")) | DEPTH | layer("Combined", "RGB") | layer("", "Z")),
    "no other layer": ("", opaque(layer("", "RGBA")) | layer("", "Z")),
    "grey": ("View.Combined", layer("View.Combined", "Y") | DEPTH),
}  # fmt: skip


@pytest.mark.parametrize("case", LAYERED)
def test_colours_of_one_layer_are_smoothed_as_if_they_were_alone(case, tmp_path):
    name, channels = LAYERED[case]
    channels = {key: plane.copy() for key, plane in channels.items()}
    other = next(key for key in channels if key.endswith("Z") or key.startswith("diffuse"))
    channels[other][0, :3] = np.nan, np.inf, -0.0
    prefix = f"{name}." if name else ""
    letters = [letter for letter in "RGBArgbY" if f"{prefix}{letter}" in channels]
    after, warnings = smoothed(tmp_path, channels)
    assert not warnings
    alone, _ = smoothed(tmp_path, {letter: channels[f"{prefix}{letter}"] for letter in letters})
    for letter in letters:
        np.testing.assert_array_equal(after.pop(f"{prefix}{letter}"), alone[letter])
        assert (alone[letter] != channels[f"{prefix}{letter}"]).any() == (letter != "A")
    for key, plane in after.items():
        np.testing.assert_array_equal(bits(plane), bits(channels[key]), err_msg=key)


TWO = layer("View.Diffuse", "RGB") | layer("View.Glossy", "RGB", seed=1) | DEPTH


GLOSSY = {"View.Glossy.R", "View.Glossy.G", "View.Glossy.B"}
OUTSIDE = LAYERED["outside of layers"][1]


@pytest.mark.parametrize(
    ("channels", "chosen", "changed"),
    [
        (TWO, ("view.glossy",), GLOSSY),
        (TWO, ("View.Glossy.R", "View.Glossy.G", "View.Glossy.B"), GLOSSY),
        (TWO, ("View.Glossy.G",), {"View.Glossy.G"}),
        (TWO, ("View.Normal",), {"View.Normal.X", "View.Normal.Y", "View.Normal.Z"}),
        (TWO, ("View.Glossy", "View.Mist.Z"), {*GLOSSY, "View.Mist.Z"}),
        (OUTSIDE, ("r", "g", "b"), {"R", "G", "B"}),
        (OUTSIDE, ("red", "View.Normal.X"), {"R", "View.Normal.X"}),
        (OUTSIDE, ("Combined",), {"Combined.R", "Combined.G", "Combined.B"}),
        (OUTSIDE, ("combined.g", "View.Depth"), {"Combined.G", "View.Depth.Z"}),
    ],
)
def test_channels_choose_a_layer(channels, chosen, changed, tmp_path):
    """Colours without a layer are those outside of layers."""
    after, _ = smoothed(tmp_path, channels, channels=chosen)
    assert {key for key, plane in after.items() if (bits(plane) != bits(channels[key])).any()} == changed


@pytest.mark.parametrize(
    ("channels", "cause"),
    [
        (TWO, "its colours could be the layers View.Diffuse or View.Glossy"),
        (layer("A.Combined", "RGB") | layer("B.Combined", "RGB"), "the layers A.Combined or B.Combined"),
        (DEPTH, "none of its layers View.Depth, View.Mist, View.Normal has red, green and blue"),
    ],
)
def test_ambiguous_layers_are_refused_by_their_names(channels, cause, tmp_path):
    with pytest.raises(InputError, match=cause) as refused:
        smoothed(tmp_path, channels)
    assert "--channels LAYER" in str(refused.value.remedy)
    assert not (tmp_path / "out.exr").exists()


def test_info_shows_the_channels_that_were_taken(tmp_path):
    path = tmp_path / "in.exr"
    path.write_bytes(exr_file(TWO | layer("View.Combined", "RGB")))
    image = json.loads(beltrami("info", str(path), "--json").stdout)["image"]
    assert image["colours"] == ["View.Combined.R", "View.Combined.G", "View.Combined.B"]
    assert image["smoothed"] == ["red", "green", "blue"]


def test_a_file_of_one_layer_is_read_as_one_without_layers():
    image = read_image(exr_file(layer("View.Normal", "XYZ")), "x.exr")
    assert image.colour == (0, 1, 2)


@pytest.mark.parametrize("target", [".png", ".tif", ".jpg", ".webp", ".tga"])
def test_another_format_gets_the_colours_of_the_layer(target):
    channels = opaque(layer("Albedo", "RGB") | layer("View.Combined", "RGBA")) | layer("View.Depth", "Z")
    image = read_image(exr_file(channels), "x.exr")
    again = read_image(write_image(image, image.pixels, suffix=target, as_data=True).data, f"x{target}")
    assert again.channels[:3] == ("R", "G", "B")
    assert again.alpha == (None if target in (".jpg", ".webp") else 3)  # WebP leaves out what is opaque
    expected = np.stack([channels[f"View.Combined.{letter}"] for letter in "RGB"], axis=2)
    full = 1 if target == ".tif" else np.iinfo(again.pixels.dtype).max
    if target not in (".jpg", ".webp"):
        np.testing.assert_allclose(again.pixels[..., :3] / full, expected, atol=0.5 / 255 + 1e-6)
    assert any("other channels are dropped" in loss for loss in conversion_losses(image, target)) == (
        target != ".tif"
    )


def parts_file(path, parts):
    """Write an EXR file of several parts, each a name with its channels, type, compression and pixels."""
    specs = []
    for name, channels, kind, compression, pixels in parts:
        spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], len(channels), kind)
        spec.channelnames = tuple(channels)
        spec.full_width = spec.full_height = SIDE  # all parts have the same display window
        for key, value in {
            "oiio:subimagename": name,
            "compression": compression,
            "comments": f"of {name}",
        }.items():
            spec.attribute(key, value)
        specs.append(spec)
    file = OpenImageIO.ImageOutput.create("openexr")
    assert file.open(str(path), tuple(specs))
    for number, spec in enumerate(specs):
        assert number == 0 or file.open(str(path), spec, "AppendSubimage")
        assert file.write_image(parts[number][-1])
    assert file.close()


def pixels(channels, kind=np.float32, size=(SIDE, SIDE)):
    return np.random.default_rng(channels).integers(0, 1000, (*size, channels)).astype(kind) / kind(1000)


PARTS = [
    ("depth", "Z", "float", "zip", pixels(1)),
    ("rgba", "RGB", "half", "piz", pixels(3)),
    ("crypto", ("id",), "uint", "zips", np.arange(SIDE * SIDE, dtype=np.uint32).reshape(SIDE, SIDE, 1)),
    ("albedo", ("albedo.R", "albedo.G", "albedo.B"), "half", "dwaa", pixels(3)),
    ("small", "N", "float", "none", pixels(1, size=(3, 5))),
]


def test_other_parts_are_copied(tmp_path):
    source, target = tmp_path / "in.exr", tmp_path / "out.exr"
    parts_file(source, PARTS)
    report = smooth_file(source, target, **KERNEL)
    assert not report.warnings
    old, new = (OpenImageIO.ImageInput.open(str(path)) for path in (source, target))
    for number, (name, channels, kind, compression, _) in enumerate(PARTS):
        specs = [file.spec(number, 0) for file in (old, new)]
        assert specs[1].getattribute("oiio:subimagename") == name
        assert specs[1].get_string_attribute("compression") == compression
        assert specs[1].get_string_attribute("ImageDescription") == f"of {name}"
        before, after = (file.read_image(number, 0, 0, len(channels), kind) for file in (old, new))
        assert np.array_equal(before, after) == (name != "rgba")
    assert not new.seek_subimage(len(PARTS), 0)
    image = json.loads(beltrami("info", str(source), "--json").stdout)["image"]
    assert (image["part"], image["colours"]) == ("rgba", ["R", "G", "B"])
    assert "all but rgba are dropped" in " ".join(
        conversion_losses(read_image(source.read_bytes(), "x.exr"), ".png")
    )


def test_parts_of_which_several_are_pictures_are_refused_by_their_names(tmp_path):
    parts_file(
        tmp_path / "in.exr",
        [("left", "RGB", "half", "zip", pixels(3)), ("right", "RGB", "half", "zip", pixels(3))],
    )
    with pytest.raises(InputError, match="it has the parts left, right, and several could be the colours"):
        smooth_file(tmp_path / "in.exr", tmp_path / "out.exr", **KERNEL)


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
    return jpeg_segment(0xE1, f"{_ADOBE}{tree}".encode())


def with_segments(jpeg, *segments):
    return jpeg[:2] + b"".join(segments) + jpeg[2:]


def index_of(order, length, others):
    """Return an index of images: the length of the first, and lengths and offsets of the others."""
    size = 16 * (1 + len(others))
    fields = [(0xB000, 7, 4, int.from_bytes(b"0100", "little" if order == "<" else "big"))]
    fields += [(0xB001, 4, 1, 1 + len(others)), (0xB002, 7, size, 50)]
    entries = [(0x030000, length, 0), *((0, *other) for other in others)]
    payload = b"MPF\0" + (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, 3)
    payload += b"".join(struct.pack(f"{order}HHII", *field) for field in fields) + bytes(4)
    return jpeg_segment(
        0xE2, payload + b"".join(struct.pack(f"{order}IIIHH", *entry, 0, 0) for entry in entries)
    )


def in_one_file(first, others, order="<"):
    """Put images into one file, with an index in front."""
    room = len(index_of(order, 0, [(0, 0)] * len(others)))
    length, places = len(first) + room, []
    for other in others:
        # Offsets count from the byte order mark: behind the start of the file, a marker, a length and "MPF".
        places.append((len(other), length + sum(size for size, _ in places) - (2 + 4 + 4)))
    return with_segments(first, index_of(order, length, places)) + b"".join(others)


def gain_map():
    """Return a gain map that makes an image up to four times as bright."""
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
    plain = encode(phantom(side=64), "jpeg", compression="jpeg:95")
    return in_one_file(with_segments(plain, container, jpeg_segment(0xE2, _ISO + bytes(4))), [gain], order)


def as_openimageio_reads(data):
    """Return the channels, the type and the mean of a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.jpg"
        path.write_bytes(data)
        file = OpenImageIO.ImageInput.open(str(path))
        return file.spec().nchannels, str(file.spec().format), file.read_image("float")[..., :3].mean()


def pictures_of(data):
    """Return all images of a file, found by its index."""
    with Image.open(io.BytesIO(data)) as file:
        found = []
        for number in range(getattr(file, "n_frames", 1)):
            file.seek(number)
            found.append(np.asarray(file.convert("RGB")))
        return found


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_gain_map_is_kept_and_not_applied(order):
    source = ultra_hdr(order)
    image = read_image(source, "x.jpg")
    assert (image.stored, image.pixels.shape, image.notices) == ("uint8", (64, 64, 3), ())
    assert np.abs(image.pixels.mean() - phantom(side=64).mean()) < 1
    size = measure_image(source, "x.jpg")
    assert (size.channels, size.sample) == (3, 1)
    new = write_image(image, image.pixels // 2 + 60).data
    assert new.endswith(gain_map())
    assert new.count(b"Item:Length") == new.count(_ISO) == 1
    before, after = as_openimageio_reads(source), as_openimageio_reads(new)
    if before[:2] == (3, "uint8"):
        pytest.skip("this build of OpenImageIO does not read gain maps")
    assert before[:2] == after[:2] == (4, "half")
    light = srgb_to_linear((image.pixels // 2 + 60) / np.float32(255))
    assert after[2] > 1.1 * light.mean()  # since the map was found and applied


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("quality", [30, 98])  # smaller and larger than the source
def test_the_index_finds_all_pictures_again(order, quality):
    others = [encode(np.full((16, 16, 3), level, np.uint8), "jpeg") for level in (50, 200)]
    source = in_one_file(encode(phantom(side=64), "jpeg", compression="jpeg:80"), others, order)
    assert len(pictures_of(source)) == 3
    image = read_image(source, "x.jpg")
    new = write_image(image, image.pixels[::-1], jpeg_quality=quality).data
    first, *further = pictures_of(new)
    np.testing.assert_array_equal(first, read_image(new, "x.jpg").pixels)
    assert [round(each.mean()) for each in further] == [50, 200]
    assert struct.unpack_from(f"{order}I", new, new.index(b"MPF\0") + 4 + 54)[0] == len(new) - sum(
        map(len, others)
    )


@pytest.mark.parametrize("suffix", [".png", ".tif", ".exr", ".webp"])
def test_other_formats_report_the_loss_and_claim_no_gain_map(suffix):
    image = read_image(ultra_hdr(), "x.jpg")
    assert any(
        "what follows it in the JPEG file is dropped" in notice for notice in conversion_losses(image, suffix)
    )
    new = write_image(image, image.pixels, suffix=suffix).data
    assert not any(word in new for word in (b"hdrgm", b"GainMap", _ISO))
    assert not conversion_losses(read_image(encode(phantom(side=64), "jpeg"), "x.jpg"), ".png")


@pytest.mark.parametrize("damage", [b"MPF\0II*\0\xff\xff\xff\xff", b"MPF\0", b"MPF\0II*\0\x08\0\0\0\0\0"])
def test_an_index_that_cannot_be_read_stays_as_it_is(damage):
    source = with_segments(encode(phantom(side=64), "jpeg"), jpeg_segment(0xE2, damage)) + b"video"
    image = read_image(source, "x.jpg")
    new = write_image(image, image.pixels // 2).data
    assert jpeg_segment(0xE2, damage) in new
    assert new.endswith(b"\xff\xd9video")


@pytest.mark.parametrize("progressive", [0, 1])
def test_the_end_of_an_image_is_found_behind_all_its_scans(progressive):
    plain = encode(phantom(side=64), "jpeg", jpeg__progressive=progressive)
    image = read_image(plain + b"\xff\xd8\xff", "x.jpg")
    assert write_image(image, 255 - image.pixels).data.count(b"\xff\xd9\xff\xd8\xff") == 1
    np.testing.assert_array_equal(image.pixels, read_image(plain, "x.jpg").pixels)


PIXELS = np.random.default_rng(1).integers(0, 256, (40, 56, 3)).astype(np.uint8)
SPANS = {"4:4:4": (0, (1, 1)), "4:2:2": (1, (1, 2)), "4:2:0": (2, (2, 2))}


def jpeg(mode="RGB", suffix=".jpg", **options):
    return saved(Image.fromarray(PIXELS).convert(mode), suffix, **options)


@pytest.mark.parametrize("subsampling", SPANS)
@pytest.mark.parametrize(("quality", "progressive"), [(50, False), (75, True), (92, False), (100, False)])
def test_tables_are_those_that_pillow_reads(subsampling, quality, progressive):
    number, span = SPANS[subsampling]
    data = jpeg(quality=quality, subsampling=number, progressive=progressive, comment=b"x" * 300)
    found = read_jpeg_tables(memoryview(data))
    with Image.open(io.BytesIO(data)) as image:
        expected = [np.reshape(image.quantization[k], (8, 8)) for k in (0, 1)]
    assert found is not None
    assert found.span == span
    np.testing.assert_array_equal(found.steps, expected)


def test_grey_pictures_have_one_table_and_other_files_none():
    found = read_jpeg_tables(jpeg(mode="L", quality=80))
    assert (found.steps.shape, found.span) == ((1, 8, 8), (1, 1))
    whole = bytearray(jpeg(quality=85))
    at = whole.index(b"\xff\xdb") + 5
    tables = read_jpeg_tables(bytes(whole))
    assert tables.steps[0, 0, 0] == whole[at]
    for end in range(2, whole.index(b"\xff\xda") + 20):
        found = read_jpeg_tables(bytes(whole[:end]))
        assert found is None or np.array_equal(found.steps, tables.steps)
    whole[at] = 0  # which is not a step
    for data in (jpeg(mode="CMYK"), jpeg(keep_rgb=True), jpeg(suffix=".png"), b"", bytes(whole)):
        assert read_jpeg_tables(data) is None
