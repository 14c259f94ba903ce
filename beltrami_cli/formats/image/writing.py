"""Writing pixels as the kind of file that they came from, or as another kind, and which metadata are lost by that."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, UsageError, install_hint
from beltrami_cli.formats.image import extra_codecs, headers, metadata, tiff_tags
from beltrami_cli.formats.image.conversion import TECHNICAL, converted
from beltrami_cli.formats.image.encoding import (
    LOSSY_EXR,
    described,
    encoded,
    reading_back,
    unwritten,
)
from beltrami_cli.formats.image.metadata import FORMATS_WITH_EXIF, carry_exif, exif_of
from beltrami_cli.formats.image.picture import (
    FORMATS,
    TYPES,
    Picture,
    format_of_suffix,
    full_scale_one,
    label_of,
)
from beltrami_cli.formats.image.reading import opened, read_image
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import ImageFile

_ROWS = 64  # that are compared at a time
_SPLICED = ("png", "jpeg", "webp")  # formats whose metadata are carried over as bytes


def is_exact(picture: Picture) -> bool:
    """Whether a picture written in its own format keeps the values that are not changed."""
    if picture.format == "webp":
        return metadata.is_lossless_webp(picture.source)
    if picture.format in ("jpeg", *extra_codecs.EXTRA_CODECS):
        return False
    return picture.spec.get_string_attribute("compression") not in LOSSY_EXR


def noise_losses(picture: Picture, suffix: str | None, remedy: str) -> tuple[str, ...]:
    """Return a notice if noise is written in the image's own format, and that is not exact."""
    if suffix is not None or is_exact(picture):
        return ()
    kind = label_of(picture.format)
    what = "is not exact and takes some of the noise away, most of all in hues"
    return (f"{picture.name}: {kind} {what}; {remedy}",)


# Single fields of the profile would be kept as well; samples of fewer bits would lose the new values. One image is
# written; announced as more it would count as truncated, and the means belong to the old one.
_NOT_KEPT = (
    "ICCProfile:", "oiio:BitsPerSample", "textureformat", "openexr:levelmode", "openexr:roundingmode",
    "oiio:AverageColor", "oiio:ConstantColor",
)  # fmt: skip
_STORAGE_IN_TIFF = ("tiff:", "oiio:", "compression", "planarconfig")
_CHOICES = ".tif, .png or .exr as the ending of OUTPUT or, of textures, with --texture-format"
_FROM_TOP = 0x20  # bit of byte 17 of a TGA file: the first row is the top one


def write_image(
    picture: Picture,
    pixels: Array,
    *,
    suffix: str | None = None,
    jpeg_quality: int = 98,
    small: bool = False,  # spend time on a smaller file
    as_data: bool = False,  # normals and the like, whose numbers no change of encoding may touch
) -> ImageFile:
    """Encode new pixels of a picture as the file that it came from, or in another format."""
    # PNG, TIFF, TGA, BMP, lossless WebP and floats keep every value, also under an alpha of 0. What came as lossy WebP
    # stays so, since lossless files are several times as large.
    known = check_writable(picture, suffix)
    if known in extra_codecs.EXTRA_CODECS:
        return _write_extra(picture, pixels, known, jpeg_quality, as_data=as_data)
    if known != picture.format:
        values, spec = converted(picture, pixels, known, as_data=as_data)
        data = encoded(spec, values, known, picture.name, jpeg_quality, small=small)
        data = metadata.without_additions(data, known)
        if known in FORMATS_WITH_EXIF:  # OpenImageIO writes some fields of it
            data, made = described(data, spec, known, picture.name)
            data = carry_exif(picture.source, picture.format, data, known, made)
        notices = [*lost_metadata(picture, data, known)]
        if known == "webp":
            again = _decoded(data, picture.name)
            notices += extra_codecs.encoding_cost(known, values, again, picture.name)
        return ImageFile(data, FORMATS[known].suffixes[0], tuple(notices))
    notices = []
    if picture.is_alpha_empty:
        pixels = pixels.copy()
        pixels[..., -1] = 0
    if known == "png" and metadata.has_palette(picture.source, known):
        notices.append(f"{picture.name} has a palette, which becomes full colours.")
    spec = _bare_spec(picture) if known in _SPLICED else _kept_spec(picture)
    exact = is_exact(picture)
    encode = partial(
        encoded, spec, known=known, name=picture.name, quality=jpeg_quality, small=small, lossless=exact
    )
    data = encode(pixels)
    if known == "targa" and (data[17] ^ picture.source[17]) & _FROM_TOP:
        # OpenImageIO puts the top row first in runs, and last otherwise; engines may expect one order of all files.
        turned = bytearray(encode(pixels[::-1]))
        turned[17] ^= _FROM_TOP
        data = bytes(turned)
    if not exact:
        again = _decoded(data, picture.name)
        if _square_error(again, pixels) > _square_error(picture.pixels, pixels) > 0:
            what = f"coded as {label_of(known)} again, it would be further from the result than it is"
            notice = f"{picture.name} stays as it is: {what}; a format without loss would hold the result."
            return ImageFile(picture.source, picture.suffix, (notice,))
        if known == "webp":
            notices = extra_codecs.encoding_cost(known, pixels, again, picture.name)
    return _with_metadata(picture, data, notices)


def is_kept(picture: Picture, file: ImageFile) -> bool:
    """Whether a file, written by `write_image`, has all new values of a picture: in its own format, without loss."""
    is_own = format_of_suffix(file.suffix) == format_of_suffix(picture.suffix)
    return is_own and is_exact(picture) and picture.format != "hdr"


def colours_in_file(picture: Picture, file: ImageFile, *, as_data: bool) -> tuple[Array, Array]:
    """Return the colours of a picture, shape (H, W, K), as they were and as a file has them, in the file's encoding."""
    with reading_back():
        again = read_image(file.data, str(PurePosixPath(picture.name).with_suffix(file.suffix)))
    if again.format == picture.format:
        return picture.pixels[..., picture.colour], again.pixels[..., picture.colour]
    after = again.pixels[..., again.colour]
    return converted(picture, picture.pixels, again.format, as_data=as_data)[0][..., : after.shape[2]], after


def _decoded(data: bytes, name: str) -> Array:
    with reading_back():
        return read_image(data, name).pixels


def _square_error(some: Array, others: Array) -> float:
    return sum(
        float(np.square(full_scale_one(some[rows]) - full_scale_one(others[rows])).sum(dtype=np.float64))
        for rows in large_arrays.blocks(len(some), _ROWS)
    )


def _with_metadata(picture: Picture, encoded: bytes, notices: list[str]) -> ImageFile:
    """Return pixels, encoded in the format that a picture has, with its metadata, and a notice of lost metadata."""
    data = encoded
    try:
        data = metadata.carry_over(picture.source, encoded, picture.format, picture.part or 0)
    except metadata.DAMAGED as error:
        if len(picture.parts) > 1:
            cause = "the table of its parts is damaged"
            raise InputError(picture.name, cause, "export it again") from error
    return ImageFile(data, picture.suffix, (*notices, *lost_metadata(picture, data, picture.format)))


def check_writable(picture: Picture, suffix: str | None) -> str:
    """Return the format of a suffix (None: the picture's own); UsageError if it cannot hold this image."""
    known = picture.format if suffix is None else format_of_suffix(suffix)
    missing = extra_codecs.missing_package(known) if known in extra_codecs.EXTRA_CODECS else None
    if known is not None and missing is not None:
        cause = f"{picture.name}: to write {label_of(known)} the package {missing} is needed"
        raise UsageError(f"{cause}; {install_hint(extra_codecs.EXTRA)}")
    if known is not None and len(picture.colour) > max(FORMATS[known].channels):
        cause = f"{label_of(known)} holds grey only, but the image has colours"
        raise UsageError(f"{picture.name}: {cause}; choose .ppm")
    what = label_of(known) if known is not None else suffix
    if known == picture.format == "bmp" and not metadata.is_plain_bmp(picture.source):
        what = "BMP with a palette, 16 bits or a header of OS/2"
    elif known is not None and FORMATS[known].writable:
        return known
    raise UsageError(f"{picture.name}: images cannot be written as {what}; choose {_CHOICES}")


def _write_extra(picture: Picture, pixels: Array, known: str, quality: int, *, as_data: bool) -> ImageFile:
    source, values = picture.source, pixels
    if known != picture.format:
        source, values = b"", converted(picture, pixels, known, as_data=as_data)[0]
    quality = min(max(quality, 1), 100)
    try:
        data = extra_codecs.encoded(known, values, quality, source, as_data=as_data)
    except extra_codecs.FAILURES as error:
        raise unwritten(picture.name, known, str(error)) from None
    with reading_back():
        again = extra_codecs.decoded(data, known, picture.name)[0]
    cost = extra_codecs.encoding_cost(known, values, again, picture.name)
    return ImageFile(data, FORMATS[known].suffixes[0], (*cost, *lost_metadata(picture, data, known)))


def _bare_spec(picture: Picture) -> Any:
    import OpenImageIO

    height, width, channels = picture.pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[picture.stored])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    subsampling = picture.spec.get_string_attribute("jpeg:subsampling")
    spec.attribute("jpeg:subsampling", subsampling or "4:4:4")
    if picture.format == "jpeg" and metadata.is_progressive_jpeg(picture.source):
        spec.attribute("jpeg:progressive", 1)
    return spec


def _kept_spec(picture: Picture) -> Any:
    spec = picture.spec.copy()
    for prefix in _NOT_KEPT:
        spec.erase_attribute(f"{prefix}.*")
    if picture.format == "tiff":  # whose tags are copied from the source
        for attribute in list(spec.extra_attribs):
            if not attribute.name.startswith(_STORAGE_IN_TIFF):
                spec.erase_attribute(attribute.name)
        if tiff_tags.is_big(picture.source):
            spec.attribute("tiff:bigtiff", 1)
    if picture.format not in ("tiff", "openexr"):  # Those two store, and say, whether alpha is multiplied in.
        spec.attribute("oiio:UnassociatedAlpha", 1)
    return spec


# Attributes of OpenImageIO about samples in a file's own format.
_STORAGE = ("oiio:", "compression", "ICCProfile:", "bmp:")
_OF_EXIF = ("Exif:", "GPS:", "ExposureTime", "FNumber")  # attributes that it makes of EXIF and GPS data
_MAKER_NOTE = " 37500"  # the end of the name of a tag of EXIF that it does not read
# Values that mean the same as no attribute; the chromaticities are from Rec. 709.
_DEFAULTS: dict[str, Any] = {
    "Orientation": 1, "PixelAspectRatio": 1.0, "ResolutionUnit": "in", "screenWindowWidth": 1.0,
    "screenWindowCenter": (0.0, 0.0), "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
}  # fmt: skip
_CARRIED = ("png", "jpeg", "webp", "tiff", "openexr", "avif")  # whose metadata are carried over as bytes
_PNG_STRUCTURE = ("tRNS", "acTL", "fcTL", "fdAT")  # other notices tell what becomes of these
_PNG_READ = ("tEXt", "zTXt", "iTXt", "pHYs", "eXIf", "iCCP", "gAMA", "cHRM", "sRGB", "cICP", "tIME", "oFFs")
_BMP_PROFILES = (b"KNIL", b"DEBM")  # in another file, or behind the pixels; by the header of version 5
_PROFILE_HEADER = 124  # bytes of it
_APP0, _APP14, _APP15, _COMMENT = 0xE0, 0xEE, 0xEF, 0xFE
# Another notice reports that the pictures of an index (MPF) are dropped.
_JPEG_READ = ("JFIF", "MPF", "Exif", "http://ns.adobe.com/xap/1.0/", "ICC_PROFILE", "Photoshop 3.0", "COM")
_HEADER_BOX = b"jp2h"
# That hold pixels, or how they are stored, in JPEG 2000 and JPEG XL.
_BOXES = (
    b"jP  ", b"ftyp", _HEADER_BOX, b"ihdr", b"bpcc", b"colr", b"pclr", b"cmap", b"cdef", b"jp2c",
    b"JXL ", b"jxlc", b"jxlp", b"jxll", b"jxli",
)  # fmt: skip
_JPEG_2000_TILE = b"\xff\x90"
_JPEG_2000_COMMENT = re.compile(rb"\xff\x64..\x00\x01(?!Created by OpenJPEG)", re.DOTALL)


def lost_metadata(picture: Picture, data: bytes, known: str) -> tuple[str, ...]:
    """Return a notice that names the metadata of a picture that a file of a format, made from it, does not have."""
    is_own = known == picture.format
    try:
        items = _items(picture.source, picture.format)
        lost = {*items} - {*_items(data, known)} if is_own else {name for name in items if not items[name]}
        if not is_own or known not in _CARRIED:
            lost |= _lost_attributes(picture, data, known)
    except metadata.DAMAGED:
        return (f"{picture.name}: its metadata are damaged, and only a part of them is kept.",)
    if not lost:
        return ()
    return (f"{picture.name}: these metadata are not kept in {label_of(known)}: {', '.join(sorted(lost))}.",)


def _lost_attributes(picture: Picture, data: bytes, known: str) -> set[str]:
    """Return the names of the attributes in OpenImageIO's view that the new file lacks."""
    now = set[str]()
    if known not in extra_codecs.EXTRA_CODECS:
        with reading_back(), opened(data, name=picture.name) as (file, _):
            if file is None:
                raise unwritten(picture.name, known, "it is not read back")
            now = {each.name.lower() for each in file.spec().extra_attribs}
    exif, new_exif = (
        tiff_tags.exif_tags(exif_of(*each)) for each in ((picture.source, picture.format), (data, known))
    )
    technical = _STORAGE if known == picture.format else (*TECHNICAL, "thumbnail_")
    # In another format OpenImageIO calls some of EXIF otherwise, or does not read them.
    seen = (*technical, *_OF_EXIF) if exif and new_exif else technical
    lost = {
        f"EXIF tag {tag}" for tag in exif.keys() - new_exif.keys() if new_exif or tag.endswith(_MAKER_NOTE)
    }
    return lost | {
        each.name
        for each in picture.spec.extra_attribs
        if not each.name.startswith(seen) and each.name.lower() not in now and not _is_default(each)
    }


def _is_default(attribute: Any) -> bool:
    default = _DEFAULTS.get(attribute.name)
    if default is None or isinstance(default, str):
        return default is not None and attribute.value == default
    return np.shape(attribute.value) == np.shape(default) and np.allclose(attribute.value, default, atol=1e-6)


def _items(data: bytes, known: str) -> dict[str, bool]:
    """Return names for the pieces of metadata in a file, and whether OpenImageIO reads each, for another format."""
    match known:
        case "png":
            kinds = {kind.decode("latin-1") for kind, _ in metadata.png_chunks(data) if kind[:1].islower()}
            return {f"PNG chunk {kind}": kind in _PNG_READ for kind in kinds - {*_PNG_STRUCTURE}}
        case "jpeg":
            return {f"JPEG segment {name}": name in _JPEG_READ for name in _jpeg_names(data)}
        case "webp":
            kinds = {kind.decode("latin-1") for kind, _ in metadata.webp_metadata(data)}
            return {f"WebP chunk {kind}": kind in ("ICCP", "EXIF", "XMP ") for kind in kinds}
        case "tiff":
            return {f"TIFF tag {tag}": is_read for tag, is_read in tiff_tags.tags(data).items()}
        case "openexr":
            return {f"EXR attribute {name}": is_read for name, is_read in headers.attributes(data).items()}
        case "jpeg2000" | "j2k" | "jpegxl":
            boxes = (kind.decode("latin-1").strip() for kind in _boxes(data) if kind not in _BOXES)
            lost = [f"box {box}" for box in boxes]
            has_comment = known != "jpegxl" and _JPEG_2000_COMMENT.search(data.partition(_JPEG_2000_TILE)[0])
            return dict.fromkeys([*lost, "comment"] if has_comment else lost, False)
        case "hdr" | "ppm" | "pgm" | "pfm":
            return dict.fromkeys(headers.header_lines(data, known), False)
        case "targa" if data.endswith(metadata.TARGA_END) and any(data[-22:-18]):
            return {"developer area": False}
        case "bmp" if data[70:74] in _BMP_PROFILES and data[14] >= _PROFILE_HEADER:
            return {"colour profile": False}
        case "ktx2":
            return {f"KTX2 key {name}": False for name in extra_codecs.ktx2_keys(data)}
        case "avif":
            names = extra_codecs.avif_metadata(data)
            return {name.upper(): False for name in names if name != "icc_profile"}
    return {}


def _jpeg_names(data: bytes) -> Iterator[str]:
    for marker, segment in metadata.jpeg_segments(data):
        if marker == _COMMENT:
            yield "COM"
        elif _APP0 <= marker <= _APP15 and marker != _APP14:
            yield bytes(segment[4:]).partition(b"\0")[0][:40].decode("latin-1")


def _boxes(data: bytes) -> Iterator[bytes]:
    """Give the types of the boxes of an ISO file; a bare stream of code has none."""
    at = 0
    while at + 8 <= len(data) and data[4:8] in (b"jP  ", b"JXL "):
        size, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        yield kind
        if kind == _HEADER_BOX:  # with boxes of its own
            size = 8
        elif size == 1:
            size = int.from_bytes(data[at + 8 : at + 16])
        if size < 8:  # up to the end of the file
            return
        at += size
