"""Writing pixels as the kind of file that they came from, or as another kind, and notices of losses."""

from __future__ import annotations

from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, ProcessingError, UsageError
from beltrami_cli.formats.image import extra_codecs, metadata, tiff_tags
from beltrami_cli.formats.image.lost_metadata import lost_metadata
from beltrami_cli.formats.image.metadata import FORMATS_WITH_EXIF, carry_exif, exif_of
from beltrami_cli.formats.image.picture import (
    FORMATS,
    TYPES,
    WRITABLE,
    Picture,
    as_stored,
    format_of_suffix,
    full_scale_one,
    is_associated,
    label_of,
    without_alpha,
)
from beltrami_cli.formats.image.reading import error_of, read_image, scratch_file
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import ImageFile, linear_to_srgb, srgb_to_linear

_ROWS = 64  # that are compared at a time
_BITS = {"uint8": 8, "uint16": 16, "float16": 16, "float32": 32}
_INEXACT = ("jpeg", "webp", "hdr")  # and KTX2 and AVIF, whose encoder says how much
_LOSSY = ("b44", "b44a", "dwaa", "dwab", "pxr24")  # compressions of EXR; TIFF is written without any
_TECHNICAL = (
    "oiio:", "jpeg:", "png:", "webp:", "tiff:", "openexr:", "targa:", "bmp:", "ICCProfile:", "jpegxl:", "pnm:", "dpx:",
    "rla:", "gif:", "psd:",
    "hdrgm:", "Container:", "Item:", "rdf:",  # of a gain map, which stays behind
)  # fmt: skip
_ALSO_TECHNICAL = ("compression", "planarconfig", "ICCProfile", "chromaticities", "textureformat")
_SPLICED = ("png", "jpeg", "webp")  # formats whose metadata are carried over as bytes
_TURNED_BY_TAGS = FORMATS_WITH_EXIF  # which programs that show pictures obey


def losses(picture: Picture, suffix: str) -> tuple[str, ...]:
    """Return notices of losses and changes when a picture is written with the suffix of another format."""
    known = format_of_suffix(suffix)
    if known is None or known == picture.format:
        return ()
    traits, name, label = FORMATS[known], picture.name, suffix.lower().lstrip(".").upper()
    source, stored = _finest(picture, known), _type_in(_finest(picture, known), known)
    found = []
    if picture.alpha is not None and not traits.alpha:
        found.append(f"{name}: {label} has no alpha, which is dropped.")
    if len(picture.channels) > len(picture.colour) + (picture.alpha is not None) and not _holds_any(known):
        found.append(f"{name}: {label} holds colours and alpha only; other channels are dropped.")
    if len(picture.parts) > 1:
        found.append(
            f"{name}: {label} holds one part only; all but {picture.parts[picture.part or 0]} are dropped."
        )
    if known == "openexr" and _has_hidden_colours(picture):
        found.append(f"{name}: {label} multiplies colours by alpha, so those under an alpha of 0 are lost.")
    if metadata.further_pictures(picture.source):
        dropped = (
            "what follows it in the JPEG file is dropped (a gain map for HDR displays, previews, a video)"
        )
        found.append(f"{name}: {label} holds one picture; {dropped}.")
    if _needs_three(picture, known):
        found.append(f"{name}: {label} has no such grey; it becomes equal red, green and blue.")
    if picture.encoding == "linear" and stored.startswith("uint"):
        found.append(f"{name}: floats become {_BITS[stored]}-bit integers in {label}, clipped to 0..1.")
    elif _BITS[stored] < _BITS[source]:
        found.append(f"{name}: {_BITS[source]}-bit samples become {_BITS[stored]}-bit ones in {label}.")
    if stored.startswith("uint") and picture.pixels.dtype.kind == "f" and np.isnan(picture.pixels).any():
        found.append(f"{name}: NaN becomes 0 in {label}.")
    if known in _INEXACT:
        found.append(f"{name}: {label} is not exact, so untouched colours change slightly as well.")
    return tuple(found)


def is_exact(picture: Picture) -> bool:
    """Whether a picture written in its own format keeps the values that are not changed."""
    if picture.format == "webp":
        return metadata.is_lossless_webp(picture.source)
    if picture.format in ("jpeg", *extra_codecs.EXTRA_CODECS):
        return False
    return picture.spec.get_string_attribute("compression") not in _LOSSY


def upright(picture: Picture, pixels: Array, suffix: str | None) -> tuple[Array, list[str]]:
    """Turn pixels as they are to be seen, if another format has no tag that says so; return also a notice."""
    known = None if suffix is None else format_of_suffix(suffix)
    turned = picture.spec.get_int_attribute("Orientation", 1)  # by EXIF, 1 to 8
    if known in (None, picture.format, *_TURNED_BY_TAGS) or turned not in range(2, 9):
        return pixels, []
    if turned in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if turned in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if turned in (3, 4, 7, 8):
        pixels = pixels[::-1]
    what = "has no tag that says how a picture is turned, so the pixels are turned"
    return pixels, [f"{picture.name}: {label_of(known)} {what}."]


def noise_losses(picture: Picture, suffix: str | None, remedy: str) -> tuple[str, ...]:
    """Return a notice if noise is written in the image's own format, and that is not exact."""
    if suffix is not None or is_exact(picture):
        return ()
    kind = label_of(picture.format)
    what = "is not exact and takes some of the noise away, most of all in hues"
    return (f"{picture.name}: {kind} {what}; {remedy}",)


def converted(picture: Picture, pixels: Array, known: str, *, as_data: bool) -> tuple[Array, Any]:
    """Return pixels as another format stores them, and their OpenImageIO.ImageSpec for it."""
    # Unless they are data, colours become linear light in floats and sRGB in integers.
    stored = _type_in(_finest(picture, known), known)
    kept = _kept_channels(picture, known)
    values = without_alpha(picture, full_scale_one(pixels))[:, :, kept]
    colour = [kept.index(channel) for channel in picture.colour]
    alpha = kept.index(picture.alpha) if picture.alpha in kept else None
    if not as_data and picture.encoding == "linear" and stored.startswith("uint"):
        values[:, :, colour] = linear_to_srgb(np.maximum(values[:, :, colour], 0))
    if not as_data and picture.encoding == "srgb" and stored.startswith("float"):
        values[:, :, colour] = srgb_to_linear(values[:, :, colour])
    if known == "openexr" and alpha is not None:  # where alpha is always multiplied in
        values[:, :, colour] *= values[:, :, [alpha]]
    names = [picture.channels[channel] for channel in kept]
    if known != "openexr":  # elsewhere channels have no names of their own, but roles
        names[:] = [_role(picture, channel) for channel in kept]
    if _needs_three(picture, known):
        values = values[:, :, [colour[0]] * 3 + ([alpha] if alpha is not None else [])]
        names = ["R", "G", "B", *(["A"] if alpha is not None else [])]
    return as_stored(values, stored), _spec(picture, values.shape, names, stored, known)


def _finest(picture: Picture, known: str) -> str:
    """Return the type of the channels that another format takes over, the finest if they differ."""
    return max((picture.kinds[channel] for channel in _kept_channels(picture, known)), key=_BITS.__getitem__)


def _type_in(stored: str, known: str) -> str:
    """Return the type that a format stores samples of a type in: the coarsest that holds them, or the finest."""
    types = FORMATS[known].types
    if stored in types:
        return stored
    finer = [kind for kind in types if _BITS[kind] > _BITS[stored] or stored == "uint8"]
    return finer[0] if finer else types[-1]


def _holds_any(known: str) -> bool:
    """Whether a format holds channels besides colours and alpha."""
    return known in ("tiff", "openexr", "rla")


def _kept_channels(picture: Picture, known: str) -> list[int]:
    """Return the channels that a format holds, colours and alpha first."""
    alpha = [picture.alpha] if picture.alpha is not None and FORMATS[known].alpha else []
    first = [*picture.colour, *alpha]
    further = [channel for channel in range(len(picture.channels)) if channel not in first]
    return [*first, *further] if _holds_any(known) else first


def _role(picture: Picture, channel: int) -> str:
    """Return R, G, B, Y or A for a colour or alpha, and the name of any other channel."""
    if channel == picture.alpha:
        return "A"
    if channel not in picture.colour:
        return picture.channels[channel]
    return "RGB"[picture.colour.index(channel)] if len(picture.colour) == 3 else "Y"


def _needs_three(picture: Picture, known: str) -> bool:
    return len(_kept_channels(picture, known)) not in FORMATS[known].channels and len(picture.colour) == 1


def _spec(picture: Picture, shape: tuple[int, ...], names: list[str], stored: str, known: str) -> Any:
    import OpenImageIO

    height, width, channels = shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[stored])
    # Names in an EXR file need not be UTF-8.
    spec.channelnames = tuple(
        name.encode(errors="surrogateescape").decode(errors="replace") for name in names
    )
    # Copied one by one from Python, integers of 16 bits are lost, and texts that are no UTF-8 cannot be.
    spec.extra_attribs = picture.spec.extra_attribs
    # By patterns: names that are no UTF-8 cannot be given from Python.
    for pattern in (*(f"{prefix}.*" for prefix in _TECHNICAL), *_ALSO_TECHNICAL):
        spec.erase_attribute(pattern)
    if known not in _TURNED_BY_TAGS:
        spec.erase_attribute("Orientation")
    profile = picture.spec.getattribute("ICCProfile")
    fits = picture.encoding == "srgb" and stored.startswith("uint")
    if profile is not None and fits and channels - ("A" in names) == len(picture.colour):
        spec.attribute("ICCProfile", OpenImageIO.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if "A" in names:
        spec.alpha_channel = names.index("A")
        spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("jpeg:subsampling", "4:4:4")
    return spec


# Single fields of the profile would be kept as well; samples of fewer bits would lose the new values. One image is
# written; announced as more it would count as truncated, and the means belong to the old one.
_NOT_KEPT = (
    "ICCProfile:", "oiio:BitsPerSample", "textureformat", "openexr:levelmode", "openexr:roundingmode",
    "oiio:AverageColor", "oiio:ConstantColor",
)  # fmt: skip
_STORAGE_IN_TIFF = ("tiff:", "oiio:", "compression", "planarconfig")
_LEAST_JPEG_2000 = 32  # pixels: images are halved five times, and readers reject smaller ones
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
    """Encode new pixels of a picture as the file that it came from, or in another format."""
    # PNG, TIFF, TGA, BMP, lossless WebP and floats keep every value, also under an alpha of 0. What came as lossy WebP
    # stays so, since lossless files are several times as large.
    known = check_writable(picture, suffix)
    if known in extra_codecs.EXTRA_CODECS:
        return _write_extra(picture, pixels, known, jpeg_quality, as_data=as_data)
    if known != picture.format:
        values, spec = converted(picture, pixels, known, as_data=as_data)
        data = _encode(spec, values, known, picture.name, jpeg_quality, small=small)
        data = metadata.without_additions(data, known)
        if known in FORMATS_WITH_EXIF:  # OpenImageIO writes some fields of it, to WebP files none
            is_webp = known == "webp"
            made = exif_of(_one_pixel(spec, picture.name), "jpeg") if is_webp else exif_of(data, known)
            data = carry_exif(picture.source, picture.format, data, known, made)
        return ImageFile(data, FORMATS[known].suffixes[0], lost_metadata(picture, data, known))
    notices = list[str]()
    if known == "png" and metadata.has_palette(picture.source, known):
        kept = metadata.encode_with_palette(pixels, picture.source, small=small)
        if kept is not None:
            return _with_metadata(picture, kept, [])
        notices = [f"{picture.name} has a palette, which cannot hold all new colours and becomes full ones."]
    spec = _bare_spec(picture) if known in _SPLICED else _kept_spec(picture)
    exact = is_exact(picture)
    data = _encode(spec, pixels, known, picture.name, jpeg_quality, small=small, lossless=exact)
    if not exact:
        again = read_image(data, picture.name).pixels
        if _square_error(again, pixels) > _square_error(picture.pixels, pixels) > 0:
            what = f"coded as {label_of(known)} again, it would be further from the result than it is"
            notice = f"{picture.name} stays as it is: {what}; a format without loss would hold the result."
            return ImageFile(picture.source, picture.suffix, (notice,))
        if known == "webp":
            notices = [extra_codecs.encoding_cost(known, pixels, again, picture.name)]
    return _with_metadata(picture, data, notices)


def _has_hidden_colours(picture: Picture) -> bool:
    """Whether there are colours under an alpha of 0 that is not multiplied into them."""
    if picture.alpha is None or is_associated(picture):
        return False
    parts = (picture.pixels[rows] for rows in large_arrays.blocks(len(picture.pixels), _ROWS))
    return any(bool(part[part[..., picture.alpha] == 0][:, list(picture.colour)].any()) for part in parts)


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


def _one_pixel(spec: Any, name: str) -> bytes:
    import OpenImageIO

    bare = OpenImageIO.ImageSpec(1, 1, 3, "uint8")
    bare.extra_attribs = spec.extra_attribs
    bare.attribute("compression", "jpeg:90")
    return _encode_by_openimageio(bare, np.zeros((1, 1, 3), np.uint8), "jpeg", name)


def check_writable(picture: Picture, suffix: str | None) -> str:
    """Return the format of a suffix (None: the picture's own); UsageError if it cannot hold this image."""
    known = picture.format if suffix is None else format_of_suffix(suffix)
    if known in _NEEDS_SUFFIX and min(picture.pixels.shape[:2]) < _LEAST_JPEG_2000:
        raise UsageError(f"{picture.name}: an image of fewer than 32 pixels a side cannot be written as JP2")
    missing = extra_codecs.missing_package(known) if known in extra_codecs.EXTRA_CODECS else None
    if known is not None and missing is not None:
        cause = f"{picture.name}: to write {label_of(known)} the package {missing} is needed; {extra_codecs.INSTALL}"
        raise UsageError(cause)
    if known is not None and FORMATS[known].writable:
        return known
    what = label_of(known) if known is not None else suffix
    raise UsageError(f"{picture.name}: images cannot be written as {what}; choose {_CHOICES}")


def _write_extra(picture: Picture, pixels: Array, known: str, quality: int, *, as_data: bool) -> ImageFile:
    source, values = picture.source, pixels
    if known != picture.format:
        source, values = b"", converted(picture, pixels, known, as_data=as_data)[0]
    quality = min(max(quality, 1), 100)
    try:
        data = extra_codecs.encoded(known, values, quality, source, as_data=as_data)
    except extra_codecs.FAILURES as error:
        raise _unwritten(picture.name, known, str(error)) from None
    again = extra_codecs.decoded(data, known, picture.name)[0]
    cost = extra_codecs.encoding_cost(known, values, again, picture.name)
    return ImageFile(data, FORMATS[known].suffixes[0], (cost, *lost_metadata(picture, data, known)))


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


def _encode(
    spec: Any, pixels: Array, known: str, name: str, quality: int, *, small: bool, lossless: bool = False
) -> bytes:
    """Encode pixels by their spec; of lossy WebP and JPEG with a quality, and WebP without loss if asked to."""
    quality = min(max(quality, 1), 100)
    if known != "webp":
        _set_options(spec, known, quality, small=small)
        return _encode_by_openimageio(spec, pixels, known, name)
    profile = spec.getattribute("ICCProfile")
    try:
        return extra_codecs.encoded_webp(
            pixels,
            quality=(100 if small else 50) if lossless else quality,
            method=6 if small else 3 if lossless else 4,
            lossless=lossless,
            profile=b"" if profile is None else bytes(np.asarray(profile, np.uint8)),
        )
    except extra_codecs.FAILURES as error:
        raise _unwritten(name, known, str(error)) from None


def _unwritten(name: str, known: str, error: str) -> ProcessingError:
    cause = error.strip() or "no reason given"
    return ProcessingError(f"{name}: the {label_of(known)} image cannot be written ({cause})")


def _set_options(spec: Any, known: str, quality: int, *, small: bool) -> None:
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
        case "jpegxl":  # without loss
            spec.attribute("compression", "jpegxl:100")
        case "tiff":
            spec.attribute("tiff:half", 1)
    if known in ("tiff", "openexr") and not spec.get_string_attribute("DateTime"):
        # Otherwise it would be the time of writing, and two runs would differ. A pair of numbers is not written at all.
        nothing = ("int[2]", (0, 0)) if known == "tiff" else ("string", "")
        spec.attribute("DateTime", *nothing)


def _encode_by_openimageio(spec: Any, pixels: Array, known: str, name: str) -> bytes:
    import OpenImageIO

    file = OpenImageIO.ImageOutput.create(known)
    if file is None:
        raise ProcessingError(f"{name}: this OpenImageIO cannot write {known} images")
    if str(spec.format) == "half" and not spec.channelformats:
        pixels = pixels.astype(np.float16)
    with scratch_file(suffix=FORMATS[known].suffixes[0] if known in _NEEDS_SUFFIX else "") as path:
        written = file.open(str(path), spec) and file.write_image(np.ascontiguousarray(pixels))
        closed = file.close()
        error = error_of(file)  # TIFF reports a missing EXIF directory though all is written.
        error_of(OpenImageIO)
        if not (written and closed):
            raise _unwritten(name, known, error.replace(str(path), "it"))
        return path.read_bytes()
