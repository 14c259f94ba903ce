"""Metadata of image files: carried over from the source to a new file, or reported as lost."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from beltrami_cli.formats.image.containers import bmp, boxes, exr, jpeg, png, targa, text_headers, tiff, webp
from beltrami_cli.formats.image.containers.jpeg import EXIF_START
from beltrami_cli.formats.image.conversion import TECHNICAL
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.encoding import one_pixel, reading_back, unwritten
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS
from beltrami_cli.formats.image.file_formats import label_of
from beltrami_cli.formats.image.opening import opened


class _Described(Protocol):
    """The files of a format: a module of `containers`, or a codec."""

    def metadata_names(self, data: bytes) -> dict[str, bool]:
        """Return names for the pieces of metadata in a file, and whether OpenImageIO reads each."""


class _Container(_Described, Protocol):
    """The files of a format whose metadata are carried over."""

    def carried_over(self, source: bytes, encoded: bytes) -> bytes:
        """Return a new file with the metadata of its source, and whatever else that holds besides pixels."""


class _ExifContainer(Protocol):
    """The files of a format that has a place for EXIF data."""

    def exif(self, data: bytes) -> bytes: ...

    def with_exif(self, encoded: bytes, exif_data: bytes) -> bytes:
        """Return a file with other EXIF data instead of its own."""


_CONTAINERS: Mapping[str, _Container] = {
    "png": png, "jpeg": jpeg, "webp": webp, "tiff": tiff, "openexr": exr, "bmp": bmp, "targa": targa,
    **dict.fromkeys(("hdr", "ppm", "pgm", "pfm"), text_headers),
}  # fmt: skip
_DESCRIBED: Mapping[str, _Described] = {
    **_CONTAINERS, **EXTRA_CODECS, **dict.fromkeys(("jpeg2000", "j2k", "jpegxl"), boxes),
}  # fmt: skip
_EXIF_CONTAINERS: Mapping[str, _ExifContainer] = {"png": png, "jpeg": jpeg, "webp": webp}
DAMAGED = (ValueError, LookupError, struct.error)
"""Errors that damaged metadata raise."""
_XMP = 700  # a tag of TIFF
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
    if file_format == "openexr":
        return exr.carried_over(source, encoded, part)
    container = _CONTAINERS.get(file_format)
    return encoded if container is None else container.carried_over(source, encoded)


def with_descriptions(image: DecodedImage, encoded: bytes, spec: Any, file_format: str) -> bytes:
    """Return an image that was converted to another format with its texts and EXIF data."""
    if file_format == "jpeg":
        # OpenImageIO's XMP data hold also what IPTC data would.
        xmp = tiff.value_of(one_pixel(spec, "tiff", image.name), _XMP)
        comment = spec.get_string_attribute("ImageDescription").encode()
        encoded = jpeg.with_texts(encoded, comment=comment, xmp=xmp)
    # OpenImageIO makes EXIF data of some attributes; Pillow, which writes these two formats, does not.
    if file_format in ("jpeg", "webp"):
        made = _exif_of(one_pixel(spec, "png", image.name), "png")
    else:
        made = _exif_of(encoded, file_format)
    exif = _exif_of(image.source, image.format)
    with suppress(*DAMAGED):
        made = tiff.merged_exif(exif, made) if tiff.exif_tags(exif) else made
    if not tiff.exif_tags(made):
        return encoded
    return made if file_format == "tiff" else _EXIF_CONTAINERS[file_format].with_exif(encoded, made)


def _exif_of(data: bytes, file_format: str) -> bytes:
    """Return the EXIF data of a file, which are a TIFF file without pixels; or nothing."""
    if file_format == "tiff":
        return data
    container = _EXIF_CONTAINERS.get(file_format)
    return b"" if container is None else container.exif(data).removeprefix(EXIF_START)


def _metadata_names(data: bytes, file_format: str) -> dict[str, bool]:
    described = _DESCRIBED.get(file_format)
    return {} if described is None else described.metadata_names(data)


def lost_metadata(image: DecodedImage, data: bytes, file_format: str) -> tuple[str, ...]:
    """Return a notice that names the metadata of an image that a file of a format, made from it, does not have."""
    is_own = file_format == image.format
    try:
        names = _metadata_names(image.source, image.format)
        if is_own:
            lost = names.keys() - _metadata_names(data, file_format).keys()
        else:
            lost = {name for name, is_read in names.items() if not is_read}
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
    """Return the names of the attributes in OpenImageIO's view, and of the EXIF tags, that the new file lacks."""
    exif = tiff.exif_tags(_exif_of(image.source, image.format))
    new_exif = tiff.exif_tags(_exif_of(data, file_format))
    tags = [tag for tag in exif if tag not in new_exif and (new_exif or tag.endswith(_MAKER_NOTE))]
    # Prefixes of attributes that are compared otherwise, or not at all.
    left_out = _STORAGE if file_format == image.format else (*TECHNICAL, "thumbnail_")
    if exif and new_exif:  # in another format OpenImageIO calls some of EXIF otherwise, or does not read them
        left_out = (*left_out, *_OF_EXIF)
    kept = _attributes_of(data, file_format, image.name)
    lost = [
        each.name
        for each in image.spec.extra_attribs
        if not each.name.startswith(left_out) and each.name.lower() not in kept and not _is_default(each)
    ]
    return {*lost, *(f"EXIF tag {tag}" for tag in tags)}


def _attributes_of(data: bytes, file_format: str, name: str) -> set[str]:
    """Return the lower-case names of the attributes of a new file in OpenImageIO's view."""
    if file_format in EXTRA_CODECS:
        return set()
    with reading_back(), opened(data, name=name) as (file, _):
        if file is None:
            raise unwritten(name, file_format, "it is not read back")
        return {each.name.lower() for each in file.spec().extra_attribs}


def _is_default(attribute: Any) -> bool:
    default = _DEFAULTS.get(attribute.name)
    if default is None or isinstance(default, str):
        return default is not None and attribute.value == default
    return np.shape(attribute.value) == np.shape(default) and np.allclose(attribute.value, default, atol=1e-6)
