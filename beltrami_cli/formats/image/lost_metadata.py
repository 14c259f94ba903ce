"""Which metadata of an image file are missing in the file that is written from it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from beltrami_cli.formats.image import extra_codecs, headers, metadata, tiff_tags
from beltrami_cli.formats.image.metadata import exif_of
from beltrami_cli.formats.image.picture import Picture, label_of
from beltrami_cli.formats.image.reading import opened

# Attributes of OpenImageIO that describe samples, compression or how it reads: of any format, and of its own.
_TECHNICAL = ("oiio:", "compression", "ICCProfile:")
_OF_OTHER_FORMATS = (
    *_TECHNICAL, "jpeg:", "png:", "webp:", "tiff:", "openexr:", "targa:", "bmp:", "jpegxl:", "pnm:", "dpx:", "rla:",
    "gif:", "psd:", "thumbnail_", "planarconfig", "textureformat", "hdrgm:", "Container:", "Item:", "rdf:",
)  # fmt: skip
_OF_EXIF = ("Exif:", "GPS:", "ExposureTime", "FNumber")  # attributes that it makes of EXIF and GPS data
_MAKER_NOTE = " 37500"  # the end of the name of a tag of EXIF that it does not read
# Values that mean the same as no attribute; the chromaticities are from Rec. 709.
_DEFAULTS: dict[str, Any] = {
    "Orientation": 1, "PixelAspectRatio": 1.0, "ResolutionUnit": "in", "screenWindowWidth": 1.0,
    "screenWindowCenter": (0.0, 0.0), "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
}  # fmt: skip
_CARRIED = ("png", "jpeg", "webp", "tiff", "openexr")  # formats whose metadata are carried over as bytes
_PNG_STRUCTURE = (b"tRNS", b"acTL", b"fcTL", b"fdAT")  # other notices tell what becomes of these
_PNG_READ = ("tEXt", "zTXt", "iTXt", "pHYs", "eXIf", "iCCP", "gAMA", "cHRM", "sRGB", "cICP", "tIME", "oFFs")
_TARGA_END = b"TRUEVISION-XFILE.\0"  # after the addresses of the extension and developer areas
_APP0, _APP14, _APP15, _COMMENT = 0xE0, 0xEE, 0xEF, 0xFE
# Another notice reports that the pictures of an index (MPF) are dropped.
_JPEG_READ = ("JFIF", "MPF", "Exif", "http://ns.adobe.com/xap/1.0/", "ICC_PROFILE", "Photoshop 3.0", "COM")
_BOXES = {
    "jpeg2000": (b"jP  ", b"ftyp", b"jp2h", b"jp2c"),
    "jpegxl": (b"JXL ", b"ftyp", b"jxlc", b"jxlp", b"jxll", b"jxli"),
}


def lost_metadata(picture: Picture, data: bytes, known: str) -> tuple[str, ...]:
    """Return a notice that names the metadata of a picture that a file of a format, made from it, does not have."""
    is_own = known == picture.format
    try:
        lost = _items(picture.source, known) - _items(data, known) if is_own else _unread(picture)
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
        with opened(data) as (file, _):
            now = {each.name.lower() for each in file.spec().extra_attribs}
    exif, new_exif = (
        tiff_tags.exif_tags(exif_of(*each)) for each in ((picture.source, picture.format), (data, known))
    )
    technical = _TECHNICAL if known == picture.format else _OF_OTHER_FORMATS
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


def _items(data: bytes, known: str) -> set[str]:
    """Return names for the pieces of metadata in a file."""
    match known:
        case "png":
            kinds = {bytes(kind) for kind, _ in metadata.png_chunks(data) if kind[:1].islower()}
            return {f"PNG chunk {kind.decode('latin-1')}" for kind in kinds - {*_PNG_STRUCTURE}}
        case "jpeg":
            return {f"JPEG segment {name}" for name in _jpeg_names(data)}
        case "webp":
            return {f"WebP chunk {kind.decode('latin-1')}" for kind, _ in metadata.webp_metadata(data)}
        case "tiff":
            return {f"TIFF tag {tag}" for tag in tiff_tags.tags(data)}
        case "openexr":
            return {f"EXR attribute {name}" for name in headers.attributes(data)}
        case "jpeg2000" | "jpegxl":
            return {f"box {kind.decode('latin-1')}" for kind in _boxes(data) if kind not in _BOXES[known]}
        case "hdr" | "pnm":
            return {*headers.header_lines(data, known)}
        case "targa" if data.endswith(_TARGA_END) and any(data[-len(_TARGA_END) - 4 : -len(_TARGA_END)]):
            return {"developer area"}
        case "ktx2":
            return {f"KTX2 key {name}" for name in extra_codecs.ktx2_keys(data)}
        case "avif":
            return {name.upper() for name in extra_codecs.avif_metadata(data) if name != "icc_profile"}
    return set()


def _unread(picture: Picture) -> set[str]:
    """Return the items of a picture's file that OpenImageIO does not read, and so cannot write in another format."""
    items, known = _items(picture.source, picture.format), picture.format
    match known:
        case "png":
            return items - {f"PNG chunk {kind}" for kind in _PNG_READ}
        case "jpeg":
            return items - {f"JPEG segment {name}" for name in _JPEG_READ}
        case "webp":
            return items - {f"WebP chunk {kind}" for kind in ("ICCP", "EXIF", "XMP ")}
        case "tiff":
            read = {str(tag) for tag in tiff_tags.READ_BY_OPENIMAGEIO}
            return {item for item in items if item.split()[2] not in read}
        case "openexr":
            return {f"EXR attribute {name}" for name in headers.unread(picture.source)}
    return items


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
        if size == 1:
            size = int.from_bytes(data[at + 8 : at + 16])
        if size < 8:  # up to the end of the file
            return
        at += size
