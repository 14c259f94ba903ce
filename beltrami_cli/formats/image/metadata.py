"""Metadata of image files: those that a new file takes over from its source, and those that are lost."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from beltrami_cli.formats.image import extra_codecs
from beltrami_cli.formats.image.containers import bitmaps, exr, jpeg, png, text_headers, tiff_tags, webp
from beltrami_cli.formats.image.conversion import TECHNICAL
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.encoding import one_pixel, reading_back, unwritten
from beltrami_cli.formats.image.file_formats import label_of
from beltrami_cli.formats.image.opening import opened

DAMAGED = (ValueError, LookupError, struct.error)
"""Errors that damaged metadata raise."""
_EXIF_START = b"Exif\0\0"
_XMP = 700  # a tag of TIFF
_PNG_STRUCTURE = ("tRNS", "acTL", "fcTL", "fdAT")  # other notices report these
_PNG_READ = ("tEXt", "zTXt", "iTXt", "pHYs", "eXIf", "iCCP", "gAMA", "cHRM", "sRGB", "cICP", "tIME", "oFFs")
_BMP_PROFILES = (b"KNIL", b"DEBM")  # in another file, or behind the pixels; by the header of version 5
_PROFILE_HEADER = 124  # bytes of it
# Another notice reports that the images of an index (MPF) are dropped.
_JPEG_READ = ("JFIF", "MPF", "Exif", "http://ns.adobe.com/xap/1.0/", "ICC_PROFILE", "Photoshop 3.0", "COM")
_HEADER_BOX = b"jp2h"
# That hold pixels, or how they are stored, in JPEG 2000 and JPEG XL.
_BOXES = (
    b"jP  ", b"ftyp", _HEADER_BOX, b"ihdr", b"bpcc", b"colr", b"pclr", b"cmap", b"cdef", b"jp2c",
    b"JXL ", b"jxlc", b"jxlp", b"jxll", b"jxli",
)  # fmt: skip
_JPEG_2000_TILE = b"\xff\x90"
_JPEG_2000_COMMENT = re.compile(rb"\xff\x64..\x00\x01(?!Created by OpenJPEG)", re.DOTALL)
# Attributes of OpenImageIO about samples in a file's own format.
_STORAGE = ("oiio:", "compression", "ICCProfile:", "bmp:")
_OF_EXIF = ("Exif:", "GPS:", "ExposureTime", "FNumber")  # attributes that it makes of EXIF and GPS data
_MAKER_NOTE = " 37500"  # the end of the name of a tag of EXIF that it does not read
# Values that mean the same as no attribute; the chromaticities are from Rec. 709.
_DEFAULTS: dict[str, Any] = {
    "Orientation": 1, "PixelAspectRatio": 1.0, "ResolutionUnit": "in", "screenWindowWidth": 1.0,
    "screenWindowCenter": (0.0, 0.0), "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
}  # fmt: skip
# Formats whose metadata are carried over as bytes.
_KEEPING_METADATA = ("png", "jpeg", "webp", "tiff", "openexr", "avif")


def carry_over(source: bytes, encoded: bytes, file_format: str, part: int = 0) -> bytes:
    """Return an encoded image, of a part of an EXR file, with what else another file of its format holds."""
    match file_format:
        case "png":
            return png.carried_over(source, encoded)
        case "jpeg":
            return jpeg.carried_over(source, encoded)
        case "webp":
            return webp.carried_over(source, encoded)
        case "bmp":
            return bitmaps.carried_bmp(source, encoded)
        case "targa":
            return bitmaps.carried_targa(source, encoded)
        case "tiff":
            return tiff_tags.with_tags(source, encoded)
        case "openexr":
            return exr.with_attributes(source, encoded, part)
        case "hdr" | "ppm" | "pgm" | "pfm":
            return text_headers.with_header(source, encoded, file_format)
    return encoded


def with_descriptions(image: DecodedImage, encoded: bytes, spec: Any, file_format: str) -> bytes:
    """Return an image that was converted to another format with its texts and EXIF data."""
    if file_format == "jpeg":
        # OpenImageIO's XMP data hold also what IPTC data would.
        xmp = tiff_tags.value_of(one_pixel(spec, "tiff", image.name), _XMP)
        comment = spec.get_string_attribute("ImageDescription").encode()
        encoded = jpeg.with_texts(encoded, comment=comment, xmp=xmp)
    # OpenImageIO makes EXIF data of some attributes; Pillow, which writes these two formats, does not.
    if file_format in ("jpeg", "webp"):
        made = _exif_of(one_pixel(spec, "png", image.name), "png")
    else:
        made = _exif_of(encoded, file_format)
    exif = _exif_of(image.source, image.format)
    with suppress(*DAMAGED):
        made = tiff_tags.with_exif(exif, made) if tiff_tags.exif_tags(exif) else made
    return _with_exif(made, encoded, file_format) if tiff_tags.exif_tags(made) else encoded


def _exif_of(data: bytes, file_format: str) -> bytes:
    """Return the EXIF data of a PNG, JPEG, WebP or TIFF file, which are a TIFF file without pixels; or nothing."""
    found = b""
    match file_format:
        case "tiff":
            return data
        case "png":
            found = next((bytes(chunk[8:-4]) for kind, chunk in png.chunks(data) if kind == b"eXIf"), b"")
        case "webp":
            found = next((payload for kind, payload in webp.metadata_chunks(data) if kind == b"EXIF"), b"")
        case "jpeg":
            found = next((bytes(segment[4:]) for _, segment in jpeg.segments(data) if _is_exif(segment)), b"")
    return found.removeprefix(_EXIF_START)


def _with_exif(exif: bytes, encoded: bytes, file_format: str) -> bytes:
    """Return an image with other EXIF data instead of its own; the same image if the format holds none."""
    match file_format:
        case "tiff":
            return exif
        case "png":
            header, *others = (chunk for kind, chunk in png.chunks(encoded) if kind != b"eXIf")
            return b"".join([png.START, header, png.packed_chunk(b"eXIf", exif), *others])
        case "webp":
            metadata = [chunk for chunk in webp.metadata_chunks(encoded) if chunk[0] != b"EXIF"]
            return webp.with_metadata([*metadata, (b"EXIF", exif)], encoded)
        case "jpeg":
            segments = [segment for _, segment in jpeg.segments(encoded) if not _is_exif(segment)]
            return jpeg.with_segment(encoded[:2] + b"".join(segments), jpeg.APP1, _EXIF_START + exif)
    return encoded


def _is_exif(segment: bytes | memoryview) -> bool:
    return segment[1] == jpeg.APP1 and segment[4:10] == _EXIF_START


def lost_metadata(image: DecodedImage, data: bytes, file_format: str) -> tuple[str, ...]:
    """Return a notice that names the metadata of an image that a file of a format, made from it, does not have."""
    is_own = file_format == image.format
    try:
        items = _items(image.source, image.format)
        if is_own:
            lost = items.keys() - _items(data, file_format).keys()
        else:
            lost = {name for name, is_read in items.items() if not is_read}
        if not is_own or file_format not in _KEEPING_METADATA:
            lost |= _lost_attributes(image, data, file_format)
    except DAMAGED:
        return (f"{image.name}: its metadata are damaged, and only a part of them is kept.",)
    if not lost:
        return ()
    return (
        f"{image.name}: these metadata are not kept in {label_of(file_format)}: {', '.join(sorted(lost))}.",
    )


def _lost_attributes(image: DecodedImage, data: bytes, file_format: str) -> set[str]:
    """Return the names of the attributes in OpenImageIO's view that the new file lacks."""
    now = set[str]()
    if file_format not in extra_codecs.EXTRA_CODECS:
        with reading_back(), opened(data, name=image.name) as (file, _):
            if file is None:
                raise unwritten(image.name, file_format, "it is not read back")
            now = {each.name.lower() for each in file.spec().extra_attribs}
    exif, new_exif = (
        tiff_tags.exif_tags(_exif_of(*each)) for each in ((image.source, image.format), (data, file_format))
    )
    technical = _STORAGE if file_format == image.format else (*TECHNICAL, "thumbnail_")
    # In another format OpenImageIO calls some of EXIF otherwise, or does not read them.
    seen = (*technical, *_OF_EXIF) if exif and new_exif else technical
    lost = {
        f"EXIF tag {tag}" for tag in exif.keys() - new_exif.keys() if new_exif or tag.endswith(_MAKER_NOTE)
    }
    return lost | {
        each.name
        for each in image.spec.extra_attribs
        if not each.name.startswith(seen) and each.name.lower() not in now and not _is_default(each)
    }


def _is_default(attribute: Any) -> bool:
    default = _DEFAULTS.get(attribute.name)
    if default is None or isinstance(default, str):
        return default is not None and attribute.value == default
    return np.shape(attribute.value) == np.shape(default) and np.allclose(attribute.value, default, atol=1e-6)


def _items(data: bytes, file_format: str) -> dict[str, bool]:
    """Return names for the pieces of metadata in a file, and whether OpenImageIO reads each, for another format."""
    match file_format:
        case "png":
            kinds = {kind.decode("latin-1") for kind, _ in png.chunks(data) if kind[:1].islower()}
            return {f"PNG chunk {kind}": kind in _PNG_READ for kind in kinds - {*_PNG_STRUCTURE}}
        case "jpeg":
            return {f"JPEG segment {name}": name in _JPEG_READ for name in jpeg.segment_names(data)}
        case "webp":
            kinds = {kind.decode("latin-1") for kind, _ in webp.metadata_chunks(data)}
            return {f"WebP chunk {kind}": kind in ("ICCP", "EXIF", "XMP ") for kind in kinds}
        case "tiff":
            return {f"TIFF tag {tag}": is_read for tag, is_read in tiff_tags.tags(data).items()}
        case "openexr":
            return {f"EXR attribute {name}": is_read for name, is_read in exr.attributes(data).items()}
        case "jpeg2000" | "j2k" | "jpegxl":
            boxes = (kind.decode("latin-1").strip() for kind in _boxes(data) if kind not in _BOXES)
            lost = [f"box {box}" for box in boxes]
            has_comment = file_format != "jpegxl" and _JPEG_2000_COMMENT.search(
                data.partition(_JPEG_2000_TILE)[0]
            )
            return dict.fromkeys([*lost, "comment"] if has_comment else lost, False)
        case "hdr" | "ppm" | "pgm" | "pfm":
            return dict.fromkeys(text_headers.header_lines(data, file_format), False)
        case "targa" if data.endswith(bitmaps.TARGA_END) and any(data[-22:-18]):
            return {"developer area": False}
        case "bmp" if data[70:74] in _BMP_PROFILES and data[14] >= _PROFILE_HEADER:
            return {"colour profile": False}
        case "ktx2":
            return {f"KTX2 key {name}": False for name in extra_codecs.ktx2_keys(data)}
        case "avif":
            names = extra_codecs.avif_metadata(data)
            return {name.upper(): False for name in names if name != "icc_profile"}
    return {}


def _boxes(data: bytes) -> Iterator[bytes]:
    """Yield the types of the boxes of an ISO file; a bare stream of code has none."""
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
