"""EXR files with layers and parts: one holds the colours, and all others stay bit for bit."""

from __future__ import annotations

import json

import numpy as np
import OpenImageIO
import pytest

from beltrami_cli import smooth_file
from beltrami_cli.errors import InputError
from beltrami_cli.formats.image import losses, read_image, write_image
from cli.commands import beltrami
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
    "the only picture": ("View.Noisy", layer("View.Noisy", "RGB") | DEPTH),
    "outside of layers": ("", opaque(layer("", "RGBA")) | DEPTH | layer("Combined", "RGB") | layer("", "Z")),
    "grey": ("View.Combined", layer("View.Combined", "Y") | DEPTH),
}  # fmt: skip


@pytest.mark.parametrize("case", LAYERED)
def test_colours_of_one_layer_are_smoothed_as_if_they_were_alone(case, tmp_path):
    name, channels = LAYERED[case]
    channels = {key: plane.copy() for key, plane in channels.items()}
    other = next(key for key in channels if key.endswith("Depth.Z") or key.startswith("diffuse"))
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
    picture = read_image(exr_file(layer("View.Normal", "XYZ")), "x.exr")
    assert picture.colour == (0, 1, 2)


@pytest.mark.parametrize("target", [".png", ".tif", ".jpg", ".webp", ".tga"])
def test_another_format_gets_the_colours_of_the_layer(target):
    channels = opaque(layer("Albedo", "RGB") | layer("View.Combined", "RGBA")) | layer("View.Depth", "Z")
    picture = read_image(exr_file(channels), "x.exr")
    again = read_image(write_image(picture, picture.pixels, suffix=target, as_data=True).data, f"x{target}")
    assert again.channels[:3] == ("R", "G", "B")
    assert again.alpha == (None if target in (".jpg", ".webp") else 3)  # WebP leaves out what is opaque
    expected = np.stack([channels[f"View.Combined.{letter}"] for letter in "RGB"], axis=2)
    full = 1 if target == ".tif" else np.iinfo(again.pixels.dtype).max
    if target not in (".jpg", ".webp"):
        np.testing.assert_allclose(again.pixels[..., :3] / full, expected, atol=0.5 / 255 + 1e-6)
    assert any("other channels are dropped" in loss for loss in losses(picture, target)) == (target != ".tif")


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
    assert "all but rgba are dropped" in " ".join(losses(read_image(source.read_bytes(), "x.exr"), ".png"))


def test_parts_of_which_several_are_pictures_are_refused_by_their_names(tmp_path):
    parts_file(
        tmp_path / "in.exr",
        [("left", "RGB", "half", "zip", pixels(3)), ("right", "RGB", "half", "zip", pixels(3))],
    )
    with pytest.raises(InputError, match="it has the parts left, right, and several could be the colours"):
        smooth_file(tmp_path / "in.exr", tmp_path / "out.exr", **KERNEL)
