"""Notices of what is changed or left out as an image file is read."""

from __future__ import annotations

from typing import Any

from beltrami_cli.formats.image.containers import bmp, png, targa, webp

PALETTE_IN_TIFF = 3  # its photometric interpretation
_COLOURED = 3  # channels
_COMPRESSIONS_OF_TIFF = ("", "none", "lzw", "zip", "packbits")  # that OpenImageIO writes
_WHOLE_BYTES = (8, 16, 32)


def reading_notices(file: Any, part: int, data: bytes, file_format: str, name: str) -> tuple[str, ...]:
    """Return notices of what an opened OpenImageIO.ImageInput holds that is changed or left out."""
    notices, spec = list[str](), file.spec().copy()
    if file_format == "psd":  # whose first image is all its layers together
        notices.append(f"{name} is taken as it is shown, its layers together.")
    elif file_format != "openexr" and (_is_animated(data, file_format) or file.seek_subimage(1, 0)):
        notices.append(f"{name} holds several images; only the first is read and kept.")
    if file.seek_subimage(part, 1):
        notices.append(f"{name} holds smaller copies of itself (mip levels), which are left out.")
    in_tiff = spec.get_int_attribute("tiff:PhotometricInterpretation") == PALETTE_IN_TIFF
    # In a palette of greys alone OpenImageIO sees grey, and so writes it.
    palette = in_tiff or _has_palette(data, file_format)
    if palette and file_format != "png" and spec.nchannels >= _COLOURED:
        notices.append(f"{name} has a palette, which becomes full colours.")
    if file_format == "targa" and spec.nchannels in (1, 3) and data[17] & 0x0F:
        notices.append(f"{name} has an alpha of few bits, which is dropped.")
    if file_format == "png" and not palette and any(kind == b"tRNS" for kind, _ in png.chunks(data)):
        notices.append(f"{name} has a colour that is transparent, which becomes an alpha channel.")
    bits = int(spec.get_int_attribute("oiio:BitsPerSample"))  # 0: unknown
    if file_format == "png":
        bits = data[24]
    if bits and not palette and bits not in _WHOLE_BYTES:
        notices.append(f"{name} has {bits}-bit samples, which become {8 * spec.format.size()}-bit ones.")
    return (*notices, *_tiff_notices(spec, name)) if file_format == "tiff" else tuple(notices)


def _tiff_notices(spec: Any, name: str) -> list[str]:
    notices, compression = list[str](), spec.get_string_attribute("compression")
    if spec.get_string_attribute("tiff:ColorSpace") == "YCbCr":
        notices.append(f"{name} stores brightness and hues (YCbCr), which become red, green and blue.")
    if compression not in _COMPRESSIONS_OF_TIFF:
        notices.append(f"{name} is compressed by {compression}; TIFF files are written with zip compression.")
    return notices


def _is_animated(data: bytes, file_format: str) -> bool:
    if file_format == "webp":
        return webp.is_animated(data)
    return file_format == "png" and png.is_animated(data)


def _has_palette(data: bytes, file_format: str) -> bool:
    """Whether a PNG, BMP, TGA or GIF file stores indices into a palette."""
    match file_format:
        case "png":
            return png.has_palette(data)
        case "bmp":
            return bmp.has_palette(data)
        case "targa":
            return targa.has_palette(data)
    return file_format == "gif"
