"""Which metadata of an image a file that is written from it does not have."""

from __future__ import annotations

from typing import Any

import numpy as np

from beltrami_cli.formats.image import extra_codecs, metadata, tiff_tags
from beltrami_cli.formats.image.conversion import TECHNICAL
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.encoding import reading_back, unwritten
from beltrami_cli.formats.image.exif import exif_of
from beltrami_cli.formats.image.file_formats import label_of
from beltrami_cli.formats.image.opening import opened

# Attributes of OpenImageIO about samples in a file's own format.
_STORAGE = ("oiio:", "compression", "ICCProfile:", "bmp:")
_OF_EXIF = ("Exif:", "GPS:", "ExposureTime", "FNumber")  # attributes that it makes of EXIF and GPS data
_MAKER_NOTE = " 37500"  # the end of the name of a tag of EXIF that it does not read
# Values that mean the same as no attribute; the chromaticities are from Rec. 709.
_DEFAULTS: dict[str, Any] = {
    "Orientation": 1, "PixelAspectRatio": 1.0, "ResolutionUnit": "in", "screenWindowWidth": 1.0,
    "screenWindowCenter": (0.0, 0.0), "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
}  # fmt: skip
_KEEPING_METADATA = (
    "png",
    "jpeg",
    "webp",
    "tiff",
    "openexr",
    "avif",
)  # whose metadata are carried over as bytes


def lost_metadata(image: DecodedImage, data: bytes, known: str) -> tuple[str, ...]:
    """Return a notice that names the metadata of an image that a file of a format, made from it, does not have."""
    is_own = known == image.format
    try:
        items = metadata.items(image.source, image.format)
        if is_own:
            lost = items.keys() - metadata.items(data, known).keys()
        else:
            lost = {name for name, is_read in items.items() if not is_read}
        if not is_own or known not in _KEEPING_METADATA:
            lost |= _lost_attributes(image, data, known)
    except metadata.DAMAGED:
        return (f"{image.name}: its metadata are damaged, and only a part of them is kept.",)
    if not lost:
        return ()
    return (f"{image.name}: these metadata are not kept in {label_of(known)}: {', '.join(sorted(lost))}.",)


def _lost_attributes(image: DecodedImage, data: bytes, known: str) -> set[str]:
    """Return the names of the attributes in OpenImageIO's view that the new file lacks."""
    now = set[str]()
    if known not in extra_codecs.EXTRA_CODECS:
        with reading_back(), opened(data, name=image.name) as (file, _):
            if file is None:
                raise unwritten(image.name, known, "it is not read back")
            now = {each.name.lower() for each in file.spec().extra_attribs}
    exif, new_exif = (
        tiff_tags.exif_tags(exif_of(*each)) for each in ((image.source, image.format), (data, known))
    )
    technical = _STORAGE if known == image.format else (*TECHNICAL, "thumbnail_")
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
