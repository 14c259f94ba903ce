"""Image formats and how their files are recognised; a decoded image, and which of its channels are colours.

Layers of an EXR file are groups of channels with a common prefix, such as ViewLayer.Combined.R and .G.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.records import Encoding

# Last parts of the names of layers with the final picture: in Blender, in Arnold and V-Ray, in Nuke.
_FINAL_LAYERS = ("combined", "beauty", "rgba")


def layers_of(channels: Sequence[str]) -> dict[str, list[int]]:
    """Return the numbers of the channels in each layer; "" stands for channels outside of layers."""
    layers: dict[str, list[int]] = {}
    for number, channel in enumerate(channels):
        layers.setdefault(channel.rpartition(".")[0], []).append(number)
    return layers


def coloured_layers(channels: Sequence[str]) -> list[str]:
    """Return the layers that have channels for red, green and blue, or grey."""
    return [
        layer
        for layer, numbers in layers_of(channels).items()
        if _named_colours(_channel_names([channels[number] for number in numbers])) is not None
    ]


def colour_layer(channels: Sequence[str]) -> str | None:
    """Return the layer that holds the colours of a file, or None if that is ambiguous."""
    layers, coloured = layers_of(channels), coloured_layers(channels)
    if len(layers) == 1:
        return next(iter(layers))
    if "" in coloured:
        return ""
    final = [layer for layer in coloured if layer.lower().rpartition(".")[2] in _FINAL_LAYERS]
    candidates = final or coloured
    return candidates[0] if len(candidates) == 1 else None


def colour_part(parts: Mapping[str, Sequence[str]]) -> int | None:
    """Return the number of the part, of channels by the names of parts, that holds the colours; None if ambiguous."""
    coloured = {part: layers for part, channels in parts.items() if (layers := coloured_layers(channels))}
    final = [part for part in coloured if part.lower().rpartition(".")[2] in _FINAL_LAYERS]
    plain = [part for part, layers in coloured.items() if "" in layers]
    candidates = final or plain or [*coloured] or [*parts][:1]
    return [*parts].index(candidates[0]) if len(candidates) == 1 else None


def colours_and_alpha(channels: Sequence[str], layer: str | None) -> tuple[tuple[int, ...], int | None]:
    """Return the colour channels of a layer (None: of all together), and its alpha channel.

    Colours are red, green and blue by their names, or grey, or else the first channels that are not alpha.
    """
    numbers = list(range(len(channels))) if layer is None else layers_of(channels)[layer]
    names = _channel_names([channels[number] for number in numbers])
    alpha = next((i for i, name in enumerate(names) if name in ("a", "alpha")), None)
    colour = _named_colours(names)
    if colour is None:
        others = [i for i in range(len(names)) if i != alpha] or [0]
        colour = tuple(others[:3]) if len(others) >= 3 else (others[0],)
    return tuple(numbers[i] for i in colour), None if alpha is None else numbers[alpha]


def _named_colours(names: Sequence[str]) -> tuple[int, ...] | None:
    if all(letter in names for letter in "rgb"):
        return tuple(names.index(letter) for letter in "rgb")
    if "y" in names and "x" not in names:  # a luminance, and no coordinate
        return (names.index("y"),)
    return None


def _channel_names(channels: Sequence[str]) -> list[str]:
    """Return the lower-case names of channels without the prefix of their layer."""
    return [channel.rpartition(".")[2].lower() for channel in channels]


@dataclass(frozen=True)
class ImageFormat:
    """The files and samples of a format."""

    suffixes: tuple[str, ...]
    types: tuple[str, ...] = ("uint8",)
    channels: tuple[int, ...] = (1, 2, 3, 4)  # numbers of channels; 2 and 4 include alpha
    signatures: tuple[bytes, ...] = ()
    writable: bool = True  # without loss of what it holds

    @property
    def alpha(self) -> bool:
        return 4 in self.channels


def _netpbm(kinds: bytes) -> tuple[bytes, ...]:
    return tuple(b"P%c%c" % (kind, space) for kind in kinds for space in b" \t\r\n")


_ANY = ("uint8", "uint16", "float16", "float32")  # types of samples
FORMATS = {
    "png": ImageFormat((".png",), ("uint8", "uint16"), signatures=(b"\x89PNG\r\n\x1a\n",)),
    "jpeg": ImageFormat((".jpg", ".jpeg", ".jpe", ".jfif"), ("uint8",), (1, 3), (b"\xff\xd8\xff",)),
    "webp": ImageFormat((".webp",), ("uint8",), (3, 4), (b"RIFF",)),
    "tiff": ImageFormat((".tif", ".tiff", ".tx"), _ANY, signatures=(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")),
    "openexr": ImageFormat((".exr",), ("float16", "float32"), signatures=(b"v/1\x01",)),
    "targa": ImageFormat((".tga", ".targa", ".tpic"), ("uint8",)),
    "bmp": ImageFormat((".bmp", ".dib"), ("uint8",), (3,), (b"BM",)),  # most programs ignore an alpha in it
    "hdr": ImageFormat((".hdr", ".rgbe"), ("float32",), (3,), (b"#?",)),
    "jpegxl": ImageFormat((".jxl",), _ANY, (1, 3, 4), (b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n")),
    "pnm": ImageFormat((".pnm",), ("uint8", "uint16"), (1, 3)),  # one of the next two
    "ppm": ImageFormat((".ppm", ".pnm"), ("uint8", "uint16"), (3,), _netpbm(b"36")),
    "pgm": ImageFormat((".pgm", ".pnm"), ("uint8", "uint16"), (1,), _netpbm(b"25")),
    "pfm": ImageFormat((".pfm",), ("float32",), (1, 3), _netpbm(b"Ff")),
    "ktx2": ImageFormat((".ktx2",), ("uint8",), (3, 4), (b"\xabKTX 20\xbb",)),
    "avif": ImageFormat((".avif",), ("uint8",), (3, 4)),
    # What most of these hold (two levels, palettes, layers, blocks, several sizes) would not come back as it was; the
    # first six are rare, and with them their headers.
    "jpeg2000": ImageFormat((".jp2",), signatures=(b"\0\0\0\x0cjP  \r\n\x87\n",), writable=False),
    "j2k": ImageFormat((".j2k", ".j2c"), signatures=(b"\xff\x4f\xff\x51",), writable=False),
    "dpx": ImageFormat((".dpx",), signatures=(b"SDPX", b"XPDS"), writable=False),
    "sgi": ImageFormat((".sgi", ".rgb", ".rgba", ".bw"), signatures=(b"\x01\xda",), writable=False),
    "fits": ImageFormat((".fits", ".fit", ".fts"), signatures=(b"SIMPLE  =",), writable=False),
    "rla": ImageFormat((".rla",), writable=False),
    "pbm": ImageFormat((".pbm",), signatures=_netpbm(b"14"), writable=False),
    "gif": ImageFormat((".gif",), signatures=(b"GIF87a", b"GIF89a"), writable=False),
    "psd": ImageFormat((".psd", ".psb"), signatures=(b"8BPS",), writable=False),
    "dds": ImageFormat((".dds",), signatures=(b"DDS ",), writable=False),
    "ico": ImageFormat((".ico",), signatures=(b"\0\0\1\0",), writable=False),
    "iff": ImageFormat((".iff",), signatures=(b"FOR4",), writable=False),
    "cineon": ImageFormat((".cin",), signatures=(b"\x80\x2a\x5f\xd7", b"\xd7\x5f\x2a\x80"), writable=False),
    "softimage": ImageFormat((".pic",), signatures=(b"\x53\x80\xf6\x34",), writable=False),
    "zfile": ImageFormat((".z",), signatures=(b"\x2f\x08\x67\xab", b"\xab\x67\x08\x2f"), writable=False),
    "heif": ImageFormat((".heic", ".heif"), writable=False),
}
"""The formats by OpenImageIO's names, but for `plugin_of` some; for KTX2 and AVIF see `extra_codecs`."""

WRITABLE = tuple(traits.suffixes[0] for traits in FORMATS.values() if traits.writable)
"""The usual extensions of the formats that can be written."""

READABLE = "PNG, JPEG, WebP, TIFF, EXR, TGA, BMP, HDR and what else OpenImageIO knows is read"
_TARGA_FOOTER = b"TRUEVISION-XFILE.\0"
_HEIF_BRANDS, _AVIF_BRANDS = {b"heic", b"heix", b"mif1", b"msf1"}, {b"avif", b"avis"}
_MOST_BRANDS = 256  # bytes of them
_MODELS = (".ply", ".obj", ".gltf", ".glb", ".xyz", ".pts", ".txt", ".asc", ".csv", ".npz", ".nrrd", ".nhdr")
_WITHOUT_MARK = ("targa", "rla")


def format_of(data: bytes, name: str) -> str | None:
    """Return a key of `FORMATS` by the content; for TGA and RLA, which need not have a mark, also by the name."""
    for known, traits in FORMATS.items():
        if data.startswith(traits.signatures) and (known != "webp" or data[8:12] == b"WEBP"):
            return known
    if data[4:8] == b"ftyp":
        # The major brand, its version, and the brands that the file is compatible with.
        end = min(int.from_bytes(data[:4], "big"), _MOST_BRANDS, len(data))
        brands = {data[8:12], *(data[at : at + 4] for at in range(16, end, 4))}
        if brands & _AVIF_BRANDS:
            return "avif"
        if data[8:12] in _HEIF_BRANDS:
            return "heif"
    if data.endswith(_TARGA_FOOTER):
        return "targa"
    by_name = format_of_suffix(suffix_of(name))
    return by_name if by_name in _WITHOUT_MARK else None


def suffix_for(data: bytes, name: str) -> str:
    """Return the suffix of an image with its dot: its name's if that fits, else its format's, "" if unknown."""
    known, suffix = format_of(data, name), suffix_of(name).lower()
    if known is None:
        return ""
    return suffix if suffix in FORMATS[known].suffixes else FORMATS[known].suffixes[0]


def is_image(data: bytes, name: str) -> bool:
    """Whether a file is an image, and none of the models and clouds whose text might start like one."""
    return format_of(data, name) is not None and suffix_of(name).lower() not in _MODELS


def format_of_suffix(suffix: str) -> str | None:
    """Return the format whose files have an extension (with the dot, in any case), or None."""
    return next((known for known, traits in FORMATS.items() if suffix.lower() in traits.suffixes), None)


def plugin_of(known: str) -> str:
    """Return OpenImageIO's name of a format."""
    return {"j2k": "jpeg2000", **dict.fromkeys(("ppm", "pgm", "pfm", "pbm"), "pnm")}.get(known, known)


def label_of(known: str) -> str:
    """Return what users call a format."""
    return FORMATS[known].suffixes[0][1:].upper()


def suffix_of(name: str) -> str:
    """Return the extension of a file's name with its dot, or nothing; slashes and backslashes separate folders."""
    return PurePosixPath(name.replace("\\", "/")).suffix


TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}  # of OpenImageIO
STORED = {name: kind for kind, name in TYPES.items()}
_ROWS = 64  # compared at a time
_LEAST_OPACITY = 1 / 1024  # that colours are divided by
_LEAST_STEPS = 16  # of opacity, for colours of 4 bits


@dataclass(frozen=True)
class Picture:
    """A decoded image file."""

    name: str
    # Shape (H, W, C), row 0 is the upper one, values as in the file: alpha is not multiplied into colours that are
    # stored without it, orientation tags are ignored, palettes are resolved, and half floats are float32.
    pixels: Array
    channels: tuple[str, ...]  # names of the C channels
    colour: tuple[int, ...]  # the channels that are grey, or red, green and blue
    alpha: int | None  # the channel that is the opacity
    encoding: Encoding  # display values in integer types, linear light in floats
    stored: str  # type of the colours in the file: uint8, uint16, float16 or float32
    format: str  # a key of `FORMATS`, or "array" if no file holds it
    suffix: str  # with the dot: the source's own if it fits the format
    notices: tuple[str, ...]  # for the user, one sentence each, with the image's name
    kinds: tuple[str, ...]  # type of every channel in the file; they differ in some EXR files only
    content: bytes | Callable[[], bytes] = field(repr=False)  # the file, or what reads it, as of `Texture`
    spec: Any = field(repr=False)  # OpenImageIO.ImageSpec of the file
    # Layer of an EXR file that holds the colours: "" outside of layers, None if it is ambiguous.
    layer: str | None = ""
    parts: tuple[str, ...] = ()  # names of the parts of an EXR file, which are images of their own
    part: int | None = 0  # the one with the colours; None if it is ambiguous, and the pixels are of the first
    is_alpha_empty: bool = False  # an alpha of 0 everywhere in the file, and of full scale in the pixels

    @property
    def source(self) -> bytes:
        """The file, whose metadata are carried over."""
        return self.content if isinstance(self.content, bytes) else self.content()

    @property
    def is_layered(self) -> bool:
        return layers_of(self.channels).keys() != {""}

    @property
    def names_colours(self) -> bool:
        """Whether other channels are data by their names, such as the depth Z next to R, G and B in an EXR file."""
        is_named = _named_colours(_channel_names(self.channels)) is not None
        return self.is_layered or (self.format == "openexr" and is_named)


def described(
    data: bytes, name: str, known: str, spec: Any, pixels: Array, notices: tuple[str, ...] = ()
) -> Picture:
    """Return pixels and their OpenImageIO.ImageSpec as the picture in a file (data) of a format (known)."""
    kinds = tuple(STORED[str(kind)] for kind in (spec.channelformats or [spec.format] * spec.nchannels))
    channels = tuple(spec.channelnames)
    if known == "targa" and len(channels) == 2:  # OpenImageIO calls grey and alpha red and green there.
        channels = ("Y", "A")
    layer = colour_layer(channels)
    colour, alpha = colours_and_alpha(channels, layer)
    return Picture(
        name=name,
        pixels=pixels,
        channels=channels,
        colour=colour,
        alpha=alpha,
        encoding="linear" if pixels.dtype.kind == "f" else "srgb",
        stored=kinds[colour[0]],
        kinds=kinds,
        format=known,
        suffix=suffix_for(data, name),
        notices=notices,
        content=data,
        spec=spec,
        layer=layer,
    )


def with_colours_of(picture: Picture, layer: str) -> Picture:
    """Return a picture with the colours and the alpha of another layer of its file."""
    colour, alpha = colours_and_alpha(picture.channels, layer)
    return replace(picture, layer=layer, colour=colour, alpha=alpha, stored=picture.kinds[colour[0]])


def require_colours(picture: Picture, remedy: str) -> None:
    """Raise InputError if it is ambiguous which layer or part of an EXR file holds the colours."""
    if picture.part is None:
        cause = f"it has the parts {', '.join(picture.parts)}, and several could be the colours"
        raise InputError(picture.name, cause, "save the one to be smoothed as a file of its own")
    if picture.layer is not None:
        return
    coloured = coloured_layers(picture.channels)
    if coloured:
        cause = f"its colours could be the layers {' or '.join(coloured)}"
    else:
        named = [layer for layer in layers_of(picture.channels) if layer]
        cause = f"none of its layers {', '.join(named)} has red, green and blue"
    raise InputError(picture.name, cause, remedy)


def new_picture(pixels: Array, name: str) -> Picture:
    """Describe new sRGB pixels of uint8 or uint16, RGB or RGBA with unassociated alpha, as a PNG without metadata."""
    return replace(array_picture(pixels, name, "srgb", str(pixels.dtype)), format="png", suffix=".png")


def array_picture(pixels: Array, name: str, encoding: Encoding, stored: str) -> Picture:
    """Describe pixels that no file holds, grey or RGB, with unassociated alpha or without."""
    import OpenImageIO

    height, width, channels = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[stored])
    if channels == 2:  # which OpenImageIO calls red and green
        spec.channelnames = ("Y", "A")
    return replace(described(b"", name, "array", spec, pixels), encoding=encoding)


def to_float(picture: Picture) -> Float32s:
    """Return all channels, shape (H, W, C), as `full_scale_one` does."""
    return full_scale_one(picture.pixels)


def is_associated(picture: Picture) -> bool:
    """Whether alpha is multiplied into the stored colours, as it is in EXR files and may be in TIFF files."""
    if picture.alpha is None or picture.format not in ("openexr", "tiff"):
        return False
    return not (picture.format == "tiff" and picture.spec.get_int_attribute("oiio:UnassociatedAlpha"))


def without_alpha(picture: Picture, values: Float32s) -> Float32s:
    """Return channels of full scale 1, shape (..., C), with colours divided by alpha, except where it is nearly 0."""
    if not is_associated(picture):
        return values
    straight = values.copy()
    opacity = values[..., picture.alpha]
    for channel in picture.colour:
        np.divide(values[..., channel], opacity, out=straight[..., channel], where=opacity >= _LEAST_OPACITY)
    return straight


def supplies_colour(picture: Picture, opacity: Array) -> Bools:
    """Return from their stored opacity which pixels have a colour: all but transparent ones."""
    if not is_associated(picture):
        return np.asarray(opacity != 0)
    steps = np.inf if opacity.dtype.kind == "f" else np.iinfo(opacity.dtype).max
    share = full_scale_one(opacity)
    return np.asarray((share >= max(_LEAST_OPACITY, _LEAST_STEPS / steps)) & np.isfinite(share))


def is_unchanged(picture: Picture, pixels: Array) -> bool:
    """Whether pixels, shape (H, W, C), are all as in the picture."""
    # Some rows at a time: most differ in the first ones, and a whole table of booleans is large.
    return all(np.array_equal(pixels[rows], picture.pixels[rows]) for rows in blocks(len(pixels), _ROWS))


def full_scale_one(pixels: Array) -> Float32s:
    """Return a copy of pixels in which the largest integer of their type is 1; floats stay as they are."""
    values = pixels.astype(np.float32)
    if pixels.dtype.kind != "f":
        values /= np.float32(np.iinfo(pixels.dtype).max)
    return values


def as_stored(values: Float32s, kind: str) -> Array:
    """Round values of full scale 1 to a type, clipped to its range; NaN becomes 0 in integers, halves are float32."""
    if kind == "float32":
        return values
    if kind == "float16":
        largest = np.finfo(np.float16).max
        return np.clip(values, -largest, largest).astype(np.float16).astype(np.float32)
    whole = np.clip(values, 0, 1).astype(np.float64)
    whole *= np.iinfo(kind).max
    np.rint(whole, out=whole)
    whole[np.isnan(whole)] = 0
    return whole.astype(kind)
