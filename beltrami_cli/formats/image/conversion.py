"""From one image format to another: type of samples, number of channels, encoding, and what is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS
from beltrami_cli.formats.image.metadata import is_lossless_webp
from beltrami_cli.formats.image.picture import as_stored, full_scale_one, without_alpha
from beltrami_cli.formats.image.reading import TYPES
from beltrami_cli.formats.image.recognition import FORMATS, format_of_suffix, label_of
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array
    from beltrami_cli.formats.image.picture import Picture

_BITS = {"uint8": 8, "uint16": 16, "float16": 16, "float32": 32}
_INEXACT = ("jpeg", "webp", "hdr")  # and KTX2 and AVIF, whose encoder says how much
_LOSSY = ("b44", "b44a", "dwaa", "dwab", "pxr24")  # compressions of EXR; TIFF is written without any
_TECHNICAL = (
    "oiio:", "jpeg:", "png:", "webp:", "tiff:", "openexr:", "targa:", "bmp:", "ICCProfile:", "jpegxl:", "pnm:", "dpx:",
    "rla:", "gif:", "psd:",
)  # fmt: skip
_ALSO_TECHNICAL = ("compression", "planarconfig", "ICCProfile", "chromaticities", "DateTime", "textureformat")


def losses(picture: Picture, suffix: str) -> tuple[str, ...]:
    """Return notices of what is lost or changed when a picture is written with the suffix of another format."""
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
    if _needs_three(picture, known):
        found.append(f"{name}: {label} has no such grey; it becomes equal red, green and blue.")
    if picture.encoding == "linear" and stored.startswith("uint"):
        found.append(f"{name}: floats become {_BITS[stored]}-bit integers in {label}, clipped to 0..1.")
    elif _BITS[stored] < _BITS[source]:
        found.append(f"{name}: {_BITS[source]}-bit samples become {_BITS[stored]}-bit ones in {label}.")
    if stored.startswith("uint") and picture.pixels.dtype.kind == "f" and np.isnan(picture.pixels).any():
        found.append(f"{name}: what is no number becomes 0 in {label}.")
    if known in _INEXACT:
        found.append(f"{name}: {label} is not exact, so untouched colours change slightly as well.")
    return tuple(found)


def is_exact(picture: Picture) -> bool:
    """Whether a picture written in its own format keeps the values that are not changed."""
    if picture.format == "webp":
        return is_lossless_webp(picture.source)
    return (
        picture.format not in ("jpeg", *EXTRA_CODECS)
        and picture.spec.get_string_attribute("compression") not in _LOSSY
    )


def noise_losses(picture: Picture, suffix: str | None, remedy: str) -> tuple[str, ...]:
    """Return a notice if noise is written in the image's own format, and that is not exact."""
    if suffix is not None or is_exact(picture):
        return ()
    kind = label_of(picture.format)
    return (
        f"{picture.name}: {kind} is not exact and takes some of the noise away, most of all in hues; {remedy}",
    )


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
    if _needs_three(picture, known):
        values = values[:, :, [colour[0]] * 3 + ([alpha] if alpha is not None else [])]
        names = ["R", "G", "B", *([picture.channels[kept[alpha]]] if alpha is not None else [])]
    return as_stored(values, stored), _spec(picture, values.shape, names, stored)


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
    return known in ("tiff", "openexr", "rla")


def _kept_channels(picture: Picture, known: str) -> list[int]:
    if _holds_any(known):
        return list(range(len(picture.channels)))
    alpha = [picture.alpha] if picture.alpha is not None and FORMATS[known].alpha else []
    return [*picture.colour, *alpha]


def _needs_three(picture: Picture, known: str) -> bool:
    """Whether grey must become red, green and blue."""
    return len(_kept_channels(picture, known)) not in FORMATS[known].channels and len(picture.colour) == 1


def _spec(picture: Picture, shape: tuple[int, ...], names: list[str], stored: str) -> Any:
    import OpenImageIO

    height, width, channels = shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[stored])
    spec.channelnames = tuple(names)
    for attribute in picture.spec.extra_attribs:
        if not attribute.name.startswith(_TECHNICAL) and attribute.name not in _ALSO_TECHNICAL:
            spec.attribute(attribute.name, attribute.type, attribute.value)
    profile = picture.spec.getattribute("ICCProfile")
    fits = picture.encoding == "srgb" and stored.startswith("uint")
    if profile is not None and fits and channels - ("A" in names) == len(picture.colour):
        spec.attribute("ICCProfile", OpenImageIO.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if "A" in names:
        spec.alpha_channel = names.index("A")
        spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("jpeg:subsampling", "4:4:4")
    return spec
