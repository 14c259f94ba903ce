"""A picture as another format holds it: channels, types and turned pixels, and notices of losses."""

from __future__ import annotations

from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.formats.image import jpeg
from beltrami_cli.formats.image.exif import FORMATS_WITH_EXIF
from beltrami_cli.formats.image.file_formats import FORMATS, format_of_suffix, label_of
from beltrami_cli.formats.image.picture import (
    TYPES,
    Picture,
    as_stored,
    full_scale_one,
    is_associated,
    without_alpha,
)
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

_ROWS = 64  # that are looked at together
_BITS = {"uint8": 8, "uint16": 16, "float16": 16, "float32": 32}
_INEXACT = ("jpeg", "hdr")  # and WebP, KTX2 and AVIF, whose writer says how much
# Beginnings of the names of OpenImageIO's attributes that describe samples, compression or how it reads.
TECHNICAL = (
    "oiio:", "jpeg:", "png:", "webp:", "tiff:", "openexr:", "targa:", "bmp:", "ICCProfile:", "jpegxl:", "pnm:", "dpx:",
    "rla:", "gif:", "psd:", "compression", "planarconfig", "textureformat",
    "hdrgm:", "Container:", "Item:", "rdf:",  # of a gain map, which stays behind
)  # fmt: skip
_TURNED_BY_TAGS = FORMATS_WITH_EXIF  # which programs that show pictures obey


def losses(picture: Picture, suffix: str) -> tuple[str, ...]:
    """Return notices of losses and changes when a picture is written with the suffix of another format."""
    known = format_of_suffix(suffix)
    if known is None or known == picture.format:
        return ()
    traits, name, label = FORMATS[known], picture.name, suffix.lower().lstrip(".").upper()
    source, stored = _finest(picture, known), _type_in(_finest(picture, known), known)
    found = []
    if picture.alpha is not None and not traits.alpha:
        found.append(f"{name}: {label} has no alpha, which is dropped.")
    if len(picture.channels) > len(picture.colour) + (picture.alpha is not None) and not _holds_any(known):
        found.append(f"{name}: {label} holds colours and alpha only; other channels are dropped.")
    if len(picture.parts) > 1:
        found.append(
            f"{name}: {label} holds one part only; all but {picture.parts[picture.part or 0]} are dropped."
        )
    if known == "openexr" and _has_hidden_colours(picture):
        found.append(f"{name}: {label} multiplies colours by alpha, so those under an alpha of 0 are lost.")
    if jpeg.further_pictures(picture.source):
        dropped = (
            "what follows it in the JPEG file is dropped (a gain map for HDR displays, previews, a video)"
        )
        found.append(f"{name}: {label} holds one picture; {dropped}.")
    if _needs_three(picture, known):
        found.append(f"{name}: {label} has no such grey; it becomes equal red, green and blue.")
    if picture.encoding == "linear" and stored.startswith("uint"):
        found.append(f"{name}: floats become {_BITS[stored]}-bit integers in {label}, clipped to 0..1.")
    elif _BITS[stored] < _BITS[source]:
        found.append(f"{name}: {_BITS[source]}-bit samples become {_BITS[stored]}-bit ones in {label}.")
    if stored.startswith("uint") and picture.pixels.dtype.kind == "f" and np.isnan(picture.pixels).any():
        found.append(f"{name}: NaN becomes 0 in {label}.")
    if known in _INEXACT:
        found.append(f"{name}: {label} is not exact, so untouched colours change slightly as well.")
    return tuple(found)


def upright(picture: Picture, pixels: Array, suffix: str | None) -> tuple[Array, list[str]]:
    """Turn pixels as they are to be seen, if another format has no tag that says so; return also a notice."""
    known = None if suffix is None else format_of_suffix(suffix)
    turned = picture.spec.get_int_attribute("Orientation", 1)  # by EXIF, 1 to 8
    if known in (None, picture.format, *_TURNED_BY_TAGS) or turned not in range(2, 9):
        return pixels, []
    if turned in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if turned in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if turned in (3, 4, 7, 8):
        pixels = pixels[::-1]
    what = "has no tag that says how a picture is turned, so the pixels are turned"
    return pixels, [f"{picture.name}: {label_of(known)} {what}."]


def converted(picture: Picture, pixels: Array, known: str, *, as_data: bool) -> tuple[Array, Any]:
    """Return pixels as another format stores them, and their OpenImageIO.ImageSpec for it."""
    # Unless they are data, colours become linear light in floats and sRGB in integers.
    stored = _type_in(_finest(picture, known), known)
    kept = _kept_channels(picture, known)
    values = without_alpha(picture, full_scale_one(pixels))[:, :, kept]
    colour = [kept.index(channel) for channel in picture.colour]
    alpha = kept.index(picture.alpha) if picture.alpha in kept else None
    if not as_data and picture.encoding == "linear" and stored.startswith("uint"):
        values[:, :, colour] = linear_to_srgb(np.maximum(values[:, :, colour], 0))
    if not as_data and picture.encoding == "srgb" and stored.startswith("float"):
        values[:, :, colour] = srgb_to_linear(values[:, :, colour])
    if known == "openexr" and alpha is not None:  # where alpha is always multiplied in
        values[:, :, colour] *= values[:, :, [alpha]]
    names = [picture.channels[channel] for channel in kept]
    if known != "openexr":  # elsewhere channels have no names of their own, but roles
        names[:] = [_role(picture, channel) for channel in kept]
    if _needs_three(picture, known):
        values = values[:, :, [colour[0]] * 3 + ([alpha] if alpha is not None else [])]
        names = ["R", "G", "B", *(["A"] if alpha is not None else [])]
    return as_stored(values, stored), _spec(picture, values.shape, names, stored, known)


def _finest(picture: Picture, known: str) -> str:
    """Return the type of the channels that another format takes over, the finest if they differ."""
    return max((picture.kinds[channel] for channel in _kept_channels(picture, known)), key=_BITS.__getitem__)


def _type_in(stored: str, known: str) -> str:
    """Return the type that a format stores samples of a type in: the coarsest that holds them, or the finest."""
    types = FORMATS[known].types
    if stored in types:
        return stored
    finer = [kind for kind in types if _BITS[kind] > _BITS[stored] or stored == "uint8"]
    return finer[0] if finer else types[-1]


def _holds_any(known: str) -> bool:
    """Whether a format holds channels besides colours and alpha."""
    return known in ("tiff", "openexr")


def _kept_channels(picture: Picture, known: str) -> list[int]:
    """Return the channels that a format holds, colours and alpha first."""
    alpha = [picture.alpha] if picture.alpha is not None and FORMATS[known].alpha else []
    first = [*picture.colour, *alpha]
    further = [channel for channel in range(len(picture.channels)) if channel not in first]
    return [*first, *further] if _holds_any(known) else first


def _role(picture: Picture, channel: int) -> str:
    """Return R, G, B, Y or A for a colour or alpha, and the name of any other channel."""
    if channel == picture.alpha:
        return "A"
    if channel not in picture.colour:
        return picture.channels[channel]
    return "RGB"[picture.colour.index(channel)] if len(picture.colour) == 3 else "Y"


def _needs_three(picture: Picture, known: str) -> bool:
    return len(_kept_channels(picture, known)) not in FORMATS[known].channels and len(picture.colour) == 1


def _spec(picture: Picture, shape: tuple[int, ...], names: list[str], stored: str, known: str) -> Any:
    import OpenImageIO

    height, width, channels = shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[stored])
    # Names in an EXR file need not be UTF-8.
    spec.channelnames = tuple(
        name.encode(errors="surrogateescape").decode(errors="replace") for name in names
    )
    # Copied one by one from Python, integers of 16 bits are lost, and texts that are not UTF-8 cannot be.
    spec.extra_attribs = picture.spec.extra_attribs
    # By patterns: names that are not UTF-8 cannot be given from Python.
    for pattern in (*(f"{prefix}.*" for prefix in TECHNICAL), "ICCProfile", "chromaticities"):
        spec.erase_attribute(pattern)
    if known not in _TURNED_BY_TAGS:
        spec.erase_attribute("Orientation")
    profile = picture.spec.getattribute("ICCProfile")
    fits = picture.encoding == "srgb" and stored.startswith("uint")
    if profile is not None and fits and channels - ("A" in names) == len(picture.colour):
        spec.attribute("ICCProfile", OpenImageIO.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if "A" in names:
        spec.alpha_channel = names.index("A")
        spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("jpeg:subsampling", "4:4:4")
    return spec


def _has_hidden_colours(picture: Picture) -> bool:
    """Whether there are colours under an alpha of 0 that is not multiplied into them."""
    if picture.alpha is None or is_associated(picture):
        return False
    parts = (picture.pixels[rows] for rows in large_arrays.blocks(len(picture.pixels), _ROWS))
    return any(bool(part[part[..., picture.alpha] == 0][:, list(picture.colour)].any()) for part in parts)
