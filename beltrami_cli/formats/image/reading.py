"""Reading an image file in its own depth, with every limit checked before its pixels are decoded."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.containers import bmp
from beltrami_cli.formats.image.containers.text_headers import has_usual_scale
from beltrami_cli.formats.image.decoded_image import DecodedImage, image_from
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, decode, measure
from beltrami_cli.formats.image.file_formats import READABLE, damaged_image, format_of, label_of, plugin_of
from beltrami_cli.formats.image.opening import error_of, opened, seek_colours
from beltrami_cli.formats.image.reading_notices import PALETTE_IN_TIFF, reading_notices
from beltrami_cli.formats.image.sample_types import STORED
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import Texture

_MAX_PIXELS = 1 << 28  # pixels: 16384 x 16384, the largest texture that graphics cards take
_MAX_CHANNELS = 64
_MAX_MEGABYTES = 8192  # of decoded pixels
_NOT_BUILT_IN = ("support is not configured", "is not implemented")  # of a compression, as libtiff says
_INKS = ("CMYK", "YCbCrK")  # as OpenImageIO calls them in JPEG files
_EXPORT = "export it as RGB or grey with 8 or 16 bits, or as floats"


class KeptImage:
    """The content of a texture whose decoded image is kept, for work that needs it again and again."""

    def __init__(self, texture: Texture) -> None:
        self._texture = texture

    def __call__(self) -> bytes:
        return self._texture.data

    @cached_property
    def image(self) -> DecodedImage:
        return read_texture(self._texture)


def read_texture(texture: Texture, data: bytes | None = None) -> DecodedImage:
    """Decode a texture, whose `data` may have been read already; errors name the model, too."""
    if isinstance(texture.content, KeptImage):
        return texture.content.image
    try:
        return read_image(texture.data if data is None else data, texture.name)
    except InputError as error:
        cause = f"{error.name}: {error.cause}"
        raise type(error)(texture.model or error.name, cause, error.remedy) from error


def read_image(data: bytes, name: str, *, finite: bool = True) -> DecodedImage:
    """Decode an image file; InputError if it is damaged or unsupported, or, with `finite`, not finite."""
    import OpenImageIO

    file_format = _readable_format(data, name)
    if file_format in EXTRA_CODECS:
        return _read_extra(data, name, file_format)
    OpenImageIO.attribute("limits:imagesize_MB", _MAX_MEGABYTES)
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    with opened(data, config, name) as (file, path):
        if file is None:
            raise _damaged(name, file_format, error_of(OpenImageIO), path)
        parts, part = seek_colours(file)
        spec = file.spec().copy()
        _require_decodable(spec, file.format_name(), file_format, name)
        pixels = file.read_image(part or 0, 0, 0, spec.nchannels, spec.format)
        error = error_of(file)
        if pixels is None or error:
            raise _damaged(name, file_format, error, path)
        notices = reading_notices(file, part or 0, data, file_format, name)
    pixels = pixels.reshape(spec.height, spec.width, spec.nchannels)
    is_alpha_empty = (
        file_format in ("bmp", "targa") and spec.nchannels in (2, 4) and not pixels[..., -1].any()
    )
    if is_alpha_empty:
        # Programs that make these files leave the byte for opacity empty where an image has none.
        pixels[..., -1] = np.iinfo(pixels.dtype).max
        notices += (f"{name} has an opacity of 0 everywhere, which is taken for none.",)
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32, copy=False)
        unfit = pixels.size - int(np.count_nonzero(np.isfinite(pixels))) if finite else 0
        if unfit:
            cause = f"{unfit} of its values are not finite numbers"
            raise InputError(name, cause, "repair or export it again")
    image = image_from(data, name, file_format, spec, large_arrays.kept(pixels), notices)
    return replace(image, parts=tuple(parts), part=part, is_alpha_empty=is_alpha_empty)


def _readable_format(data: bytes, name: str) -> str:
    """Return the format of a file; InputError if it is unknown, or OpenImageIO cannot read this kind of it."""
    import OpenImageIO

    file_format = format_of(data, name)
    if not data:
        raise InputError(name, "the file is empty", "export it again")
    if file_format is None:
        raise InputError(name, "the content is of no known image format", READABLE)
    built_in = OpenImageIO.get_string_attribute("input_format_list").split(",")
    if plugin_of(file_format) not in (*built_in, *EXTRA_CODECS):
        cause = f"this build of OpenImageIO does not read {label_of(file_format)}"
        raise InputError(name, cause, "convert it to PNG or EXR")
    if file_format == "bmp" and not bmp.has_usual_bits(data):
        cause = "its header, or the order of its red, green, blue and alpha, is a rare one that is not read"
        raise InputError(name, cause, "export it as PNG")
    if file_format == "pfm" and not has_usual_scale(data):
        raise InputError(name, "the scale in its header is 0, or no number", "correct it, or use EXR")
    return file_format


def _read_extra(data: bytes, name: str, file_format: str) -> DecodedImage:
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(*measure(data, file_format, name), "uint8")
    _require_decodable(spec, file_format, file_format, name)
    pixels, notices, profile = decode(data, file_format, name)
    if profile:
        kind = OpenImageIO.TypeDesc(f"uint8[{len(profile)}]")
        spec.attribute("ICCProfile", kind, np.frombuffer(profile, np.uint8))
    return image_from(data, name, file_format, spec, pixels, notices)


def _require_decodable(spec: Any, format_name: str, file_format: str, name: str) -> None:
    """Raise InputError for what must not or cannot be decoded, by its header."""
    width, height = spec.width, spec.height
    if format_name != plugin_of(file_format):
        raise InputError(name, f"it starts like a {file_format} image, but is not one", READABLE)
    if spec.deep:
        raise InputError(name, "it is a deep image, with many samples a pixel", "flatten it")
    if width <= 0 or height <= 0 or not 0 < spec.nchannels <= _MAX_CHANNELS or spec.depth > 1:
        cause = f"its size of {width} x {height} pixels, {spec.nchannels} channels cannot be used"
        raise InputError(name, cause, "export it as a plain image")
    if width * height > _MAX_PIXELS:
        cause = f"its {width} x {height} pixels are more than the {_MAX_PIXELS} that are read"
        raise InputError(name, cause, "scale it down, or split it")
    kinds = {str(kind) for kind in (spec.channelformats or (spec.format,))}
    if not kinds <= STORED.keys() or (len(kinds) > 1 and not kinds <= {"half", "float"}):
        raise InputError(name, f"its samples are {' and '.join(sorted(kinds))}", _EXPORT)
    colour_space = spec.get_string_attribute("tiff:ColorSpace")
    if "CMYK" in colour_space.upper() or spec.get_string_attribute("jpeg:ColorSpace") in _INKS:
        raise InputError(name, "its colours are the inks of print (CMYK)", "convert it to RGB")
    if (
        spec.get_int_attribute("tiff:PhotometricInterpretation") == PALETTE_IN_TIFF
        and spec.alpha_channel >= 0
    ):
        raise InputError(name, "it has a palette with an alpha channel", "convert it to RGBA")
    if colour_space.endswith("LAB"):  # OpenImageIO makes a yellow of its white, and 8 bits of 16
        raise InputError(name, f"its colours are {colour_space}", "convert it to RGB")


def _damaged(name: str, file_format: str, error: str, path: Path) -> InputError:
    lines = [line.strip() for line in error.replace(str(path), "it").splitlines() if line.strip()]
    shown = lines[0][:150] if lines else "no reason given"
    if any(word in shown for word in _NOT_BUILT_IN):
        cause = f"this build of OpenImageIO does not read how the {label_of(file_format)} image is compressed"
        return InputError(name, f"{cause} ({shown})", "save it without compression, or with another one")
    return damaged_image(name, file_format, shown)
