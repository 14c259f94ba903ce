"""Pixels to the bytes of an image file: JPEG and WebP by Pillow in memory, all else by OpenImageIO in temporary files.

OpenImageIO may report success where a temporary file could not be written in full, and of its JPEG encoder libjpeg ends
the process then. So what it has written is decoded and compared with the pixels.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, OutputError, ProcessingError
from beltrami_cli.formats.image.containers import targa
from beltrami_cli.formats.image.decoded_image import ROWS
from beltrami_cli.formats.image.extra_codecs import FAILURES
from beltrami_cli.formats.image.file_formats import label_of, plugin_of
from beltrami_cli.formats.image.opening import error_of, opened, scratch_file
from beltrami_cli.surface import large_arrays

LOSSY_EXR = ("b44", "b44a", "dwaa", "dwab", "pxr24")  # compressions
# Samples of luma in a row and in two rows for each sample of chroma. Pillow does not know the other two.
_SUBSAMPLINGS = {"4:4:4": "4:4:4", "4:2:2": "4:2:2", "4:2:0": "4:2:0", "4:1:1": "4:2:2", "4:2:1": "4:2:2"}
# Bytes of a sample of JPEG at most: a coefficient has a code of up to 16 bits and 11 more (ITU-T T.81, annex F).
_MAX_BYTES = 4
_PNG_FILTER_UP = 0x20  # as libpng numbers them
# RGBE has 8 bits for the fraction of the largest channel of a pixel, which may be half of its full scale.
_RGBE_STEP = 2.0**-7
# Ends of files whose pixels are decoded without them; all others are not.
_ENDS = {"png": b"IEND\xaeB`\x82", "targa": targa.END}


def encode(
    spec: Any,
    pixels: Array,
    file_format: str,
    name: str,
    quality: int,
    *,
    small: bool,
    lossless: bool = False,
) -> bytes:
    """Encode pixels by their spec; of lossy WebP and JPEG with a quality, and WebP without loss if asked to.

    OutputError if that fails, such as on a full disk.
    """
    if file_format not in ("jpeg", "webp"):
        _set_options(spec, file_format, small=small)
        return _encoded_by_openimageio(spec, pixels, file_format, name)
    from PIL import Image

    quality, profile, buffer = min(max(quality, 1), 100), spec.getattribute("ICCProfile"), io.BytesIO()
    options: dict[str, Any] = {
        "icc_profile": b"" if profile is None else bytes(np.asarray(profile, np.uint8))
    }
    if file_format == "jpeg":
        options |= _jpeg_options(spec, pixels.size, quality)
    elif lossless:
        options |= {"lossless": True, "quality": 100 if small else 50, "method": 6 if small else 3}
    else:
        options |= {"quality": quality, "method": 6 if small else 4}
    if file_format == "webp":
        options["exact"] = True  # also the colours under an alpha of 0, which OpenImageIO lets libwebp clear
    try:
        Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(
            buffer, file_format, **options
        )
    except FAILURES as error:
        raise unwritten(name, file_format, str(error)) from None
    return buffer.getvalue()


def _jpeg_options(spec: Any, samples: int, quality: int) -> dict[str, Any]:
    from PIL import ImageFile

    progressive = bool(spec.get_int_attribute("jpeg:progressive"))
    if progressive:  # is written at once; in Pillow's own buffer noise of a high quality has no room
        ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, _MAX_BYTES * samples)
    subsampling = _SUBSAMPLINGS.get(spec.get_string_attribute("jpeg:subsampling"), "4:4:4")
    return {"quality": quality, "progressive": progressive, "subsampling": subsampling}


def unwritten(name: str, file_format: str, error: str) -> OutputError:
    """Return the error that an encoder fails."""
    return OutputError(
        name, f"the {label_of(file_format)} image cannot be written ({error.strip() or 'no reason given'})"
    )


def one_pixel(spec: Any, file_format: str, name: str) -> bytes:
    """Encode a single pixel with the attributes of a spec, to see what OpenImageIO makes of them in a format."""
    import OpenImageIO

    bare = OpenImageIO.ImageSpec(1, 1, 3, "uint8")
    bare.extra_attribs = spec.extra_attribs
    _set_options(bare, file_format, small=False)
    return _encoded_by_openimageio(bare, np.zeros((1, 1, 3), np.uint8), file_format, name)


def _set_options(spec: Any, file_format: str, *, small: bool) -> None:
    match file_format:
        case "png":
            spec.attribute("png:compressionLevel", 9 if small else 1)
            # Differences of rows repeat little but runs. To look for more gains next to nothing and takes time, as it
            # does to try all filters on each row.
            spec.attribute("compression", "filtered" if small else "rle")
            if not small:
                spec.attribute("png:filter", _PNG_FILTER_UP)
        case "jpegxl":  # without loss
            spec.attribute("compression", "jpegxl:100")
        case "tiff":
            spec.attribute("tiff:half", 1)
    if file_format in ("tiff", "openexr") and not spec.get_string_attribute("DateTime"):
        # Otherwise it would be the time of writing, and two runs would differ. A pair of numbers is not written at all.
        nothing = ("int[2]", (0, 0)) if file_format == "tiff" else ("string", "")
        spec.attribute("DateTime", *nothing)


def _encoded_by_openimageio(spec: Any, pixels: Array, file_format: str, name: str) -> bytes:
    import OpenImageIO

    file = OpenImageIO.ImageOutput.create(plugin_of(file_format))
    if file is None:
        raise ProcessingError(f"this OpenImageIO cannot write {file_format} images", name)
    if str(spec.format) == "half" and not spec.channelformats:
        pixels = pixels.astype(np.float16)
    with scratch_file() as path:
        written = file.open(str(path), spec) and file.write_image(np.ascontiguousarray(pixels))
        closed = file.close()
        error = error_of(file)  # TIFF reports a missing EXIF directory though all is written.
        error_of(OpenImageIO)
        if not (written and closed):
            raise unwritten(name, file_format, error.replace(str(path), "it"))
        try:
            data = path.read_bytes()
        except OSError as failure:
            raise unwritten(name, file_format, f"it cannot be read back: {failure.strerror}") from failure
    _require_whole(data, spec, pixels, file_format, name)
    return data


@contextmanager
def reading_back() -> Iterator[None]:
    """Raise OutputError if a new file cannot be read back."""
    try:
        yield
    except InputError as error:
        raise OutputError(error.name, error.cause, error.remedy) from error


def _require_whole(data: bytes, spec: Any, pixels: Array, file_format: str, name: str) -> None:
    """Raise OutputError unless a new image reads back with these pixels."""
    import OpenImageIO

    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    with reading_back(), opened(data, config, name) as (file, path):
        if file is None or not data.endswith(_ENDS.get(file_format, b"")):
            raise unwritten(name, file_format, error_of(OpenImageIO).replace(str(path), "it"))
        for rows, again in _blocks_of(file):
            if again is None:
                raise unwritten(name, file_format, error_of(file).replace(str(path), "it"))
            if not _is_same(again, pixels[rows], spec, file_format):
                raise unwritten(name, file_format, "it does not read back as it was written")


def _blocks_of(file: Any) -> Iterator[tuple[slice, Array | None]]:
    """Yield the rows of an OpenImageIO.ImageInput block by block, and their pixels; None if they cannot be read."""
    spec = file.spec()
    if spec.tile_width:
        yield slice(None), file.read_image(spec.format)
        return
    for rows in large_arrays.blocks(spec.height, ROWS):
        begin, end = spec.y + rows.start, spec.y + rows.stop
        yield rows, file.read_scanlines(begin, end, 0, 0, spec.nchannels, spec.format)


def _is_same(again: Array, pixels: Array, spec: Any, file_format: str) -> bool:
    """Whether decoded pixels equal the encoded ones, as far as the format keeps them."""
    if again.shape != pixels.shape:
        return False
    if file_format == "hdr":
        return bool((np.abs(again - pixels) <= _RGBE_STEP * pixels.max(axis=2, keepdims=True)).all())
    if spec.get_string_attribute("compression").partition(":")[0] in LOSSY_EXR:
        return True
    return np.array_equal(again, pixels.astype(again.dtype), equal_nan=again.dtype.kind == "f")
