"""Write pixels in the format of the source or in another one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Uint8s
from beltrami_cli.errors import InputError, UsageError, install_hint
from beltrami_cli.formats.image import extra_codecs
from beltrami_cli.formats.image.containers import bmp, png, tiff, webp
from beltrami_cli.formats.image.conversion import conversion_losses, converted
from beltrami_cli.formats.image.decoded_image import ROWS, DecodedImage
from beltrami_cli.formats.image.encoding import LOSSY_EXR, encode, reading_back, unwritten
from beltrami_cli.formats.image.file_formats import FORMATS, FORMATS_WITH_EXIF, format_of_suffix, label_of
from beltrami_cli.formats.image.jpeg_tables import is_progressive
from beltrami_cli.formats.image.metadata import DAMAGED, carry_over, lost_metadata, with_descriptions
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import TYPES, full_scale_one
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import ImageFile

_KEEPING_BYTES = ("png", "jpeg", "webp")  # formats whose metadata are carried over as bytes
# Single fields of the profile would be kept as well; samples of fewer bits would lose the new values. One image is
# written; announced as more it would count as truncated, and the means belong to the old one.
_OMITTED_METADATA = (
    "ICCProfile:", "oiio:BitsPerSample", "textureformat", "openexr:levelmode", "openexr:roundingmode",
    "oiio:AverageColor", "oiio:ConstantColor",
)  # fmt: skip
_STORAGE_IN_TIFF = ("tiff:", "oiio:", "compression", "planarconfig")
_CHOICES = ".tif, .png or .exr as the ending of OUTPUT or, of textures, with --texture-format"
_FROM_TOP = 0x20  # bit of byte 17 of a TGA file: the first row is the top one


def is_exact(image: DecodedImage) -> bool:
    """Whether an image written in its own format keeps the values that are not changed."""
    if image.format == "webp":
        return webp.is_lossless(image.source)
    if image.format in ("jpeg", *extra_codecs.EXTRA_CODECS):
        return False
    return image.spec.get_string_attribute("compression") not in LOSSY_EXR


def noise_losses(image: DecodedImage, suffix: str | None, remedy: str) -> tuple[str, ...]:
    """Return a notice if noise is written in the image's own format, and that is not exact."""
    if suffix is not None or is_exact(image):
        return ()
    kind = label_of(image.format)
    what = "is not exact and takes some of the noise away, most of all in hues"
    return (f"{image.name}: {kind} {what}; {remedy}",)


def write_image(
    image: DecodedImage,
    pixels: Array,
    *,
    suffix: str | None = None,
    jpeg_quality: int = 98,
    small: bool = False,  # spend time on a smaller file
    as_data: bool = False,  # normals and the like, whose numbers no change of encoding may touch
) -> ImageFile:
    """Encode new pixels of an image as the file that it came from, or in another format; with notices of all losses."""
    file_format = check_writable(image, suffix)
    if file_format in extra_codecs.EXTRA_CODECS:
        file = _write_extra(image, pixels, file_format, jpeg_quality, as_data=as_data)
    elif file_format == image.format:
        file = _write_in_own_format(image, pixels, jpeg_quality, small=small)
    else:
        file = _write_converted(image, pixels, file_format, jpeg_quality, small=small, as_data=as_data)
    return replace(file, notices=(*file.notices, *conversion_losses(image, suffix or image.suffix)))


def _write_converted(
    image: DecodedImage, pixels: Array, file_format: str, quality: int, *, small: bool, as_data: bool
) -> ImageFile:
    values, spec = converted(image, pixels, file_format, as_data=as_data)
    data = encode(spec, values, file_format, image.name, quality, small=small)
    if file_format == "png":
        data = png.without_additions(data)
    if file_format in FORMATS_WITH_EXIF:  # OpenImageIO writes some fields of it
        data = with_descriptions(image, data, spec, file_format)
    notices = lost_metadata(image, data, file_format)
    if file_format == "webp":
        notices += _encoding_cost(file_format, values, _pixels_of(data, image.name), image.name)
    return ImageFile(data, FORMATS[file_format].suffixes[0], notices)


def _write_in_own_format(image: DecodedImage, pixels: Array, quality: int, *, small: bool) -> ImageFile:
    # PNG, TIFF, TGA, BMP, lossless WebP and floats keep every value, also under an alpha of 0. What came as lossy WebP
    # stays so, since lossless files are several times as large.
    file_format, exact, notices = image.format, is_exact(image), tuple[str, ...]()
    if image.is_alpha_empty:
        pixels = pixels.copy()
        pixels[..., -1] = 0
    if file_format == "png" and png.has_palette(image.source):
        notices = (f"{image.name} has a palette, which becomes full colours.",)
    spec = _bare_spec(image) if file_format in _KEEPING_BYTES else _kept_spec(image)
    encode_pixels = partial(
        encode, spec, file_format=file_format, name=image.name, quality=quality, small=small, lossless=exact
    )
    data = encode_pixels(pixels)
    if file_format == "targa" and (data[17] ^ image.source[17]) & _FROM_TOP:
        # OpenImageIO puts the top row first in runs, and last otherwise; engines may expect one order of all files.
        turned = bytearray(encode_pixels(pixels[::-1]))
        turned[17] ^= _FROM_TOP
        data = bytes(turned)
    if not exact:
        again = _pixels_of(data, image.name)
        if _square_error(again, pixels) > _square_error(image.pixels, pixels) > 0:
            what = f"coded as {label_of(file_format)} again, it would be further from the result than it is"
            notice = f"{image.name} stays as it is: {what}; a format without loss would hold the result."
            return ImageFile(image.source, image.suffix, (notice,))
        if file_format == "webp":
            notices = _encoding_cost(file_format, pixels, again, image.name)
    data = _with_own_metadata(image, data)
    return ImageFile(data, image.suffix, (*notices, *lost_metadata(image, data, file_format)))


def is_kept(image: DecodedImage, file: ImageFile) -> bool:
    """Whether a file, written by `write_image`, has all new values of an image: in its own format, without loss."""
    is_own = format_of_suffix(file.suffix) == format_of_suffix(image.suffix)
    return is_own and is_exact(image) and image.format != "hdr"


def colours_in_file(image: DecodedImage, file: ImageFile, *, as_data: bool) -> tuple[Array, Array]:
    """Return the colours of an image, shape (H, W, K), as they were and as a file has them, in the file's encoding."""
    with reading_back():
        again = read_image(file.data, str(PurePosixPath(image.name).with_suffix(file.suffix)))
    if again.format == image.format:
        return image.pixels[..., image.colour], again.pixels[..., image.colour]
    after = again.pixels[..., again.colour]
    return converted(image, image.pixels, again.format, as_data=as_data)[0][..., : after.shape[2]], after


def _pixels_of(data: bytes, name: str) -> Array:
    with reading_back():
        return read_image(data, name).pixels


def _square_error(some: Array, others: Array) -> float:
    return sum(
        float(np.square(full_scale_one(some[rows]) - full_scale_one(others[rows])).sum(dtype=np.float64))
        for rows in large_arrays.blocks(len(some), ROWS)
    )


def _with_own_metadata(image: DecodedImage, data: bytes) -> bytes:
    """Return new pixels, in the format of an image, with its metadata unless they are damaged."""
    try:
        return carry_over(image.source, data, image.format, image.part or 0)
    except DAMAGED as error:
        if len(image.parts) > 1:
            cause = "the table of its parts is damaged"
            raise InputError(image.name, cause, "export it again") from error
        return data


def check_writable(image: DecodedImage, suffix: str | None) -> str:
    """Return the format of a suffix (None: the image's own); UsageError if it cannot hold this image."""
    file_format = image.format if suffix is None else format_of_suffix(suffix)
    if file_format is None:
        raise _unwritable(image, suffix)
    label = label_of(file_format)
    if file_format in extra_codecs.EXTRA_CODECS and (missing := extra_codecs.missing_package(file_format)):
        cause = f"{image.name}: to write {label} the package {missing} is needed"
        raise UsageError(f"{cause}; {install_hint(extra_codecs.EXTRA)}")
    if len(image.colour) > max(FORMATS[file_format].channels):
        raise UsageError(f"{image.name}: {label} holds grey only, but the image has colours; choose .ppm")
    if file_format == image.format == "bmp" and not bmp.is_plain(image.source):
        raise _unwritable(image, "BMP with a palette, 16 bits or a header of OS/2")
    if not FORMATS[file_format].writable:
        raise _unwritable(image, label)
    return file_format


def _unwritable(image: DecodedImage, what: str | None) -> UsageError:
    return UsageError(f"{image.name}: images cannot be written as {what}; choose {_CHOICES}")


def _write_extra(
    image: DecodedImage, pixels: Array, file_format: str, quality: int, *, as_data: bool
) -> ImageFile:
    source, values = image.source, pixels
    if file_format != image.format:
        source, values = b"", converted(image, pixels, file_format, as_data=as_data)[0]
    quality = min(max(quality, 1), 100)
    try:
        data = extra_codecs.encode(values, file_format, quality, source, as_data=as_data)
    except extra_codecs.FAILURES as error:
        raise unwritten(image.name, file_format, str(error)) from None
    with reading_back():
        again = extra_codecs.decode(data, file_format, image.name)[0]
    cost = _encoding_cost(file_format, values, again, image.name)
    lost = lost_metadata(image, data, file_format)
    return ImageFile(data, FORMATS[file_format].suffixes[0], (*cost, *lost))


def _bare_spec(image: DecodedImage) -> Any:
    import OpenImageIO

    height, width, channels = image.pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[image.stored])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    subsampling = image.spec.get_string_attribute("jpeg:subsampling")
    spec.attribute("jpeg:subsampling", subsampling or "4:4:4")
    if image.format == "jpeg" and is_progressive(image.source):
        spec.attribute("jpeg:progressive", 1)
    return spec


def _kept_spec(image: DecodedImage) -> Any:
    spec = image.spec.copy()
    for prefix in _OMITTED_METADATA:
        spec.erase_attribute(f"{prefix}.*")
    if image.format == "tiff":  # whose tags are copied from the source
        for attribute in list(spec.extra_attribs):
            if not attribute.name.startswith(_STORAGE_IN_TIFF):
                spec.erase_attribute(attribute.name)
        if tiff.is_big(image.source):
            spec.attribute("tiff:bigtiff", 1)
    if image.format not in ("tiff", "openexr"):  # Those two store, and say, whether alpha is multiplied in.
        spec.attribute("oiio:UnassociatedAlpha", 1)
    return spec


def _encoding_cost(file_format: str, pixels: Uint8s, again: Uint8s, name: str) -> tuple[str, ...]:
    """Report the loss by encoding of pixels, shape (H, W, C), if any: their PSNR, full scale 255."""
    # Also of those under an alpha of 0, which opaque materials show.
    differences = again[..., :3].astype(np.float32) - pixels[..., :3]
    error = float(np.square(differences).mean())
    if not error:
        return ()
    psnr = 10 * math.log10(255**2 / error)
    inexact = f"{name}: {file_format.upper()} is not exact, so untouched colours change slightly as well"
    return (f"{inexact}: the written image has a PSNR of {psnr:.1f} dB.",)
