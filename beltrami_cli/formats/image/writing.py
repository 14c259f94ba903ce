"""Writing pixels as the kind of file that they came from, or as another kind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import ProcessingError, UsageError
from beltrami_cli.formats.image.conversion import converted
from beltrami_cli.formats.image.extra_codecs import (
    EXTRA_CODECS,
    INSTALL,
    encoded,
    encoding_cost,
    missing_package,
)
from beltrami_cli.formats.image.metadata import (
    carry_over,
    encode_with_palette,
    has_palette,
    is_lossless_webp,
    is_progressive_jpeg,
    without_additions,
)
from beltrami_cli.formats.image.reading import TYPES, scratch_file
from beltrami_cli.formats.image.recognition import FORMATS, WRITABLE, format_of_suffix, label_of
from beltrami_cli.surface.records import ImageFile

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array
    from beltrami_cli.formats.image.picture import Picture

_SPLICED = ("png", "jpeg", "webp")  # formats whose metadata are carried over as bytes
_OF_MIP_LEVELS = (
    "textureformat",
    "openexr:levelmode",
    "openexr:roundingmode",
    "oiio:AverageColor",
    "oiio:ConstantColor",
)
_LEAST_JPEG_2000 = 32  # what is halved five times; of smaller ones nobody reads what OpenImageIO writes
_NEEDS_SUFFIX = ("jpeg2000",)  # which OpenImageIO writes in two ways, by the name
_CHOICES = f"{', '.join(WRITABLE)} as the ending of OUTPUT or, of textures, with --texture-format"
_PNG_FILTER_UP = 0x20  # as libpng numbers them


def write_image(
    picture: Picture,
    pixels: Array,
    *,
    suffix: str | None = None,
    jpeg_quality: int = 98,
    small: bool = False,  # spend time on a smaller file
    as_data: bool = False,  # normals and the like, whose numbers no change of encoding may touch
) -> ImageFile:
    """Encode pixels like those of a picture as the file that it came from, or in another format."""
    # PNG, TIFF, TGA, BMP, lossless WebP and floats keep every value; in WebP, colours under an alpha of 0 are lost.
    known = check_writable(picture, suffix)
    if known in EXTRA_CODECS:
        return _write_extra(picture, pixels, known, jpeg_quality, as_data=as_data)
    if known != picture.format:
        values, spec = converted(picture, pixels, known, as_data=as_data)
        _set_options(spec, known, "", jpeg_quality, small=small)
        data = without_additions(_encode(spec, values, known, picture.name), known)
        return ImageFile(data, FORMATS[known].suffixes[0])
    notices = list[str]()
    if known == "png" and has_palette(picture.source, known):
        kept = encode_with_palette(pixels, picture.source, small=small)
        if kept is not None:
            return ImageFile(carry_over(picture.source, kept, known), picture.suffix)
        notices.append(
            f"{picture.name} has a palette, which cannot hold all new colours and becomes full ones."
        )
    spec = _bare_spec(picture) if known in _SPLICED else _kept_spec(picture)
    compression = "lossless" if known == "webp" and is_lossless_webp(picture.source) else ""
    _set_options(spec, known, compression, jpeg_quality, small=small)
    data = _encode(spec, pixels, known, picture.name)
    return ImageFile(carry_over(picture.source, data, known), picture.suffix, tuple(notices))


def check_writable(picture: Picture, suffix: str | None) -> str:
    """Return the format of a suffix (None: the picture's own); UsageError if it cannot hold this image."""
    known = picture.format if suffix is None else format_of_suffix(suffix)
    if known in _NEEDS_SUFFIX and min(picture.pixels.shape[:2]) < _LEAST_JPEG_2000:
        raise UsageError(f"{picture.name}: an image of fewer than 32 pixels a side cannot be written as JP2")
    missing = missing_package(known) if known in EXTRA_CODECS else None
    if known is not None and missing is not None:
        raise UsageError(
            f"{picture.name}: to write {label_of(known)} the package {missing} is needed; {INSTALL}"
        )
    if known is not None and FORMATS[known].writable:
        return known
    what = label_of(known) if known is not None else suffix
    raise UsageError(f"{picture.name}: images cannot be written as {what}; choose {_CHOICES}")


def _write_extra(picture: Picture, pixels: Array, known: str, quality: int, *, as_data: bool) -> ImageFile:
    """Encode pixels in a format that OpenImageIO does not have, and say what that costs."""
    is_new, values = known != picture.format, pixels
    if is_new:
        values, _ = converted(picture, pixels, known, as_data=as_data)
    quality = min(max(quality, 1), 100)
    data = encoded(known, values, quality, b"" if is_new else picture.source, as_data=as_data)
    cost = encoding_cost(known, values, data, picture.name)
    return ImageFile(data, FORMATS[known].suffixes[0], (cost,))


def _bare_spec(picture: Picture) -> Any:
    """Describe the pixels alone."""
    import OpenImageIO

    height, width, channels = picture.pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[picture.stored])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    subsampling = picture.spec.get_string_attribute("jpeg:subsampling")
    spec.attribute("jpeg:subsampling", subsampling or "4:4:4")
    if picture.format == "jpeg" and is_progressive_jpeg(picture.source):
        spec.attribute("jpeg:progressive", 1)
    return spec


def _kept_spec(picture: Picture) -> Any:
    """Describe the pixels and all that OpenImageIO knows of the file."""
    spec = picture.spec.copy()
    for attribute in list(spec.extra_attribs):
        # Single fields of the profile would be kept beside it; samples of fewer bits would lose what is new in them.
        if attribute.name.startswith("ICCProfile:") or attribute.name == "oiio:BitsPerSample":
            spec.erase_attribute(attribute.name)
        # One image is written; announced as more it would count as cut off, and these means are those of the old one.
        if attribute.name.startswith(_OF_MIP_LEVELS):
            spec.erase_attribute(attribute.name)
    if picture.format not in ("tiff", "openexr"):  # Those two store, and say, whether alpha is multiplied in.
        spec.attribute("oiio:UnassociatedAlpha", 1)
    return spec


def _set_options(spec: Any, known: str, compression: str, quality: int, *, small: bool) -> None:
    quality = min(max(quality, 1), 100)
    match known:
        case "png":
            spec.attribute("png:compressionLevel", 9 if small else 1)
            # Differences of rows repeat little but runs. To look for more gains next to nothing and takes time, as it
            # does to try all filters on each row.
            spec.attribute("compression", "filtered" if small else "rle")
            if not small:
                spec.attribute("png:filter", _PNG_FILTER_UP)
        case "jpeg":
            spec.attribute("compression", f"jpeg:{quality}")
        case "webp" if compression == "lossless":
            spec.attribute("compression", "lossless:100" if small else "lossless:50")
            spec.attribute("webp:method", 6 if small else 3)
        case "webp":
            spec.attribute("compression", f"webp:{quality}")
            spec.attribute("webp:method", 6 if small else 4)
        case "jpegxl":  # without loss
            spec.attribute("compression", "jpegxl:100")
        case "tiff":
            spec.attribute("tiff:half", 1)
    if known in ("tiff", "openexr") and not spec.get_string_attribute("DateTime"):
        # Otherwise it would be the time of writing, and two runs would differ.
        spec.attribute("DateTime", "")


def _encode(spec: Any, pixels: Array, known: str, name: str) -> bytes:
    import OpenImageIO

    file = OpenImageIO.ImageOutput.create(known)
    if file is None:
        raise ProcessingError(f"{name}: this OpenImageIO cannot write {known} images")
    if str(spec.format) == "half" and not spec.channelformats:
        pixels = pixels.astype(np.float16)
    with scratch_file(suffix=FORMATS[known].suffixes[0] if known in _NEEDS_SUFFIX else "") as path:
        written = file.open(str(path), spec) and file.write_image(np.ascontiguousarray(pixels))
        closed = file.close()
        error = file.geterror()  # TIFF reports a missing EXIF directory though all is written.
        OpenImageIO.geterror()
        if not (written and closed):
            cause = error.replace(str(path), "it").strip() or "no reason given"
            raise ProcessingError(f"{name}: the {known} image cannot be written ({cause})")
        return path.read_bytes()
