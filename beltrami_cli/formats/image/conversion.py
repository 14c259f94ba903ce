"""An image as another format holds it: channels, types and turned pixels, and notices of losses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.formats.image.alpha import is_associated, without_alpha
from beltrami_cli.formats.image.containers import jpeg
from beltrami_cli.formats.image.decoded_image import ROWS, DecodedImage
from beltrami_cli.formats.image.file_formats import FORMATS, FORMATS_WITH_EXIF, format_of_suffix, label_of
from beltrami_cli.formats.image.sample_types import TYPES, as_stored, full_scale_one
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

_BITS = {"uint8": 8, "uint16": 16, "float16": 16, "float32": 32}
_INEXACT = ("jpeg", "hdr")  # and WebP, KTX2 and AVIF, whose writer says how much
# Beginnings of the names of OpenImageIO's attributes that describe samples, compression or how it reads.
TECHNICAL = (
    "oiio:", "jpeg:", "png:", "webp:", "tiff:", "openexr:", "targa:", "bmp:", "ICCProfile:", "jpegxl:", "pnm:", "dpx:",
    "rla:", "gif:", "psd:", "compression", "planarconfig", "textureformat",
    "hdrgm:", "Container:", "Item:", "rdf:",  # of a gain map, which stays behind
)  # fmt: skip


@dataclass(frozen=True)
class _Target:
    """An image as another format holds it."""

    image: DecodedImage
    file_format: str

    @property
    def holds_any_channels(self) -> bool:
        return self.file_format in ("tiff", "openexr")

    @property
    def channels(self) -> list[int]:
        """The channels of the image that the format holds, colours and alpha first."""
        image, traits = self.image, FORMATS[self.file_format]
        first = [*image.colour, *([image.alpha] if image.alpha is not None and traits.alpha else [])]
        further = [channel for channel in range(len(image.channels)) if channel not in first]
        return [*first, *further] if self.holds_any_channels else first

    @property
    def source_type(self) -> str:
        """The type of these channels in the image, the finest if they differ."""
        return max((self.image.kinds[channel] for channel in self.channels), key=_BITS.__getitem__)

    @property
    def stored(self) -> str:
        """The coarsest type of the format that holds the values, or else its finest."""
        source, types = self.source_type, FORMATS[self.file_format].types
        if source in types:
            return source
        finer = [kind for kind in types if _BITS[kind] > _BITS[source] or source == "uint8"]
        return finer[0] if finer else types[-1]

    @property
    def becomes_rgb(self) -> bool:
        """Whether the image is grey, and the format has no such number of channels."""
        is_held = len(self.channels) in FORMATS[self.file_format].channels
        return len(self.image.colour) == 1 and not is_held

    def name_of(self, channel: int) -> str:
        """Return the name of a channel, which is R, G, B, Y or A for colours and alpha unless the format is EXR."""
        image = self.image
        if self.file_format == "openexr" or channel not in (*image.colour, image.alpha):
            return image.channels[channel]
        if channel == image.alpha:
            return "A"
        return "RGB"[image.colour.index(channel)] if len(image.colour) == 3 else "Y"


def conversion_losses(image: DecodedImage, suffix: str) -> tuple[str, ...]:
    """Return notices of losses and changes when an image is written with a suffix; none in its own format."""
    file_format = format_of_suffix(suffix)
    if file_format is None or file_format == image.format:
        return ()
    target, name, label = _Target(image, file_format), image.name, suffix.lower().lstrip(".").upper()
    source, stored = target.source_type, target.stored
    found = []
    if image.alpha is not None and not FORMATS[file_format].alpha:
        found.append(f"{name}: {label} has no alpha, which is dropped.")
    if len(image.channels) > len(image.colour) + (image.alpha is not None) and not target.holds_any_channels:
        found.append(f"{name}: {label} holds colours and alpha only; other channels are dropped.")
    if len(image.parts) > 1:
        kept = image.parts[image.part or 0]
        found.append(f"{name}: {label} holds one part only; all but {kept} are dropped.")
    if file_format == "openexr" and _has_hidden_colours(image):
        found.append(f"{name}: {label} multiplies colours by alpha, so those under an alpha of 0 are lost.")
    if jpeg.further_images(image.source):
        others = "a gain map for HDR displays, previews, a video"
        found.append(
            f"{name}: {label} holds one image; what follows it in the JPEG file is dropped ({others})."
        )
    if target.becomes_rgb:
        found.append(f"{name}: {label} has no such grey; it becomes equal red, green and blue.")
    if image.encoding == "linear" and stored.startswith("uint"):
        found.append(f"{name}: floats become {_BITS[stored]}-bit integers in {label}, clipped to 0..1.")
    elif _BITS[stored] < _BITS[source]:
        found.append(f"{name}: {_BITS[source]}-bit samples become {_BITS[stored]}-bit ones in {label}.")
    if stored.startswith("uint") and image.pixels.dtype.kind == "f" and np.isnan(image.pixels).any():
        found.append(f"{name}: NaN becomes 0 in {label}.")
    if file_format in _INEXACT:
        found.append(f"{name}: {label} is not exact, so untouched colours change slightly as well.")
    return tuple(found)


def upright(image: DecodedImage, pixels: Array, suffix: str | None) -> tuple[Array, list[str]]:
    """Turn pixels as they are to be seen, if another format has no tag that says so; return also a notice."""
    file_format = None if suffix is None else format_of_suffix(suffix)
    turned = image.spec.get_int_attribute("Orientation", 1)  # by EXIF, 1 to 8
    if file_format in (None, image.format, *FORMATS_WITH_EXIF) or turned not in range(2, 9):
        return pixels, []
    if turned in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if turned in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if turned in (3, 4, 7, 8):
        pixels = pixels[::-1]
    what = "has no tag that says how an image is turned, so the pixels are turned"
    return pixels, [f"{image.name}: {label_of(file_format)} {what}."]


def converted(image: DecodedImage, pixels: Array, file_format: str, *, as_data: bool) -> tuple[Array, Any]:
    """Return pixels as another format stores them, and their OpenImageIO.ImageSpec for it."""
    # Unless they are data, colours become linear light in floats and sRGB in integers.
    target = _Target(image, file_format)
    stored, kept = target.stored, target.channels
    values = without_alpha(image, full_scale_one(pixels))[:, :, kept]
    colour = [kept.index(channel) for channel in image.colour]
    alpha = kept.index(image.alpha) if image.alpha in kept else None
    if not as_data and image.encoding == "linear" and stored.startswith("uint"):
        values[:, :, colour] = linear_to_srgb(np.maximum(values[:, :, colour], 0))
    if not as_data and image.encoding == "srgb" and stored.startswith("float"):
        values[:, :, colour] = srgb_to_linear(values[:, :, colour])
    if file_format == "openexr" and alpha is not None:  # where alpha is always multiplied in
        values[:, :, colour] *= values[:, :, [alpha]]
    names = [target.name_of(channel) for channel in kept]
    if target.becomes_rgb:
        values = values[:, :, [colour[0]] * 3 + ([alpha] if alpha is not None else [])]
        names = ["R", "G", "B", *(["A"] if alpha is not None else [])]
    return as_stored(values, stored), _spec(target, values.shape, names)


def _spec(target: _Target, shape: tuple[int, ...], names: list[str]) -> Any:
    import OpenImageIO

    image, stored = target.image, target.stored
    height, width, channels = shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[stored])
    # Names in an EXR file need not be UTF-8.
    spec.channelnames = tuple(
        name.encode(errors="surrogateescape").decode(errors="replace") for name in names
    )
    # Copied one by one from Python, integers of 16 bits are lost, and texts that are not UTF-8 cannot be.
    spec.extra_attribs = image.spec.extra_attribs
    # By patterns: names that are not UTF-8 cannot be given from Python.
    for pattern in (*(f"{prefix}.*" for prefix in TECHNICAL), "ICCProfile", "chromaticities"):
        spec.erase_attribute(pattern)
    if target.file_format not in FORMATS_WITH_EXIF:
        spec.erase_attribute("Orientation")
    profile = image.spec.getattribute("ICCProfile")
    fits = image.encoding == "srgb" and stored.startswith("uint")
    if profile is not None and fits and channels - ("A" in names) == len(image.colour):
        spec.attribute("ICCProfile", OpenImageIO.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if "A" in names:
        spec.alpha_channel = names.index("A")
        spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("jpeg:subsampling", "4:4:4")
    return spec


def _has_hidden_colours(image: DecodedImage) -> bool:
    """Whether there are colours under an alpha of 0 that is not multiplied into them."""
    if image.alpha is None or is_associated(image):
        return False
    parts = (image.pixels[rows] for rows in large_arrays.blocks(len(image.pixels), ROWS))
    return any(bool(part[part[..., image.alpha] == 0][:, list(image.colour)].any()) for part in parts)
