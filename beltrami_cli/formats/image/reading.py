"""Reading an image file in its own depth, with every limit checked before its pixels are decoded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.changes import changes
from beltrami_cli.formats.image.metadata import is_cmyk_jpeg
from beltrami_cli.formats.image.picture import Picture
from beltrami_cli.formats.image.recognition import READABLE, format_of, label_of, suffix_for
from beltrami_cli.formats.image.scratch import scratch_file
from beltrami_cli.surface.large_arrays import copy_of, is_on_disk

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_LARGEST = 1 << 28  # pixels: 16384 x 16384, the largest texture that graphics cards take
_MOST_CHANNELS = 64
_MOST_MEGABYTES = 8192  # of decoded pixels
_STORED = {"uint8": "uint8", "uint16": "uint16", "half": "float16", "float": "float32"}
_NOT_BUILT_IN = ("support is not configured", "is not implemented")  # of a compression, as libtiff says
_EXPORT = "export it as RGB or grey with 8 or 16 bits, or as floats"


def read_image(data: bytes, name: str, *, finite: bool = True) -> Picture:
    """Decode an image file.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name, for messages and for telling TGA files.
    finite : bool
        Whether values that are not finite are refused.

    Returns
    -------
    Picture

    Raises
    ------
    InputError
        If it is of no known format, damaged or cut off, of no size or too large, of a type of sample that is not
        supported, in the inks of print (CMYK) or in CIELAB, or has values that are not finite and must not.
    """
    import OpenImageIO

    known = format_of(data, name)
    if not data:
        raise InputError(name, "the file is empty", "export it anew")
    if known is None:
        raise InputError(name, "the content is of no known image format", READABLE)
    if known == "jpeg" and is_cmyk_jpeg(data):
        raise InputError(name, "its colours are the inks of print (CMYK)", "convert it to RGB")
    if known not in OpenImageIO.get_string_attribute("input_format_list").split(","):
        raise InputError(
            name, f"this build of OpenImageIO does not read {label_of(known)}", "convert it to PNG or EXR"
        )
    OpenImageIO.attribute("limits:imagesize_MB", _MOST_MEGABYTES)
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    with scratch_file(data) as path:
        file = OpenImageIO.ImageInput.open(str(path), config)
        if file is None:
            raise _damaged(name, known, OpenImageIO.geterror(), path)
        try:
            spec = file.spec().copy()
            _check(spec, file.format_name(), known, name)
            pixels = file.read_image(0, 0, 0, spec.nchannels, spec.format)
            error = file.geterror()
            if pixels is None or error:
                raise _damaged(name, known, error, path)
            notices = changes(file, spec, data, known, name)
        finally:
            file.close()
            file.geterror()
            OpenImageIO.geterror()
    if is_on_disk():
        pixels = copy_of(pixels)
    pixels = pixels.reshape(spec.height, spec.width, spec.nchannels)
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32)
        unfit = pixels.size - int(np.count_nonzero(np.isfinite(pixels))) if finite else 0
        if unfit:
            raise InputError(
                name, f"{unfit} of its values are not finite numbers", "repair or export it anew"
            )
    return _picture(data, name, known, spec, pixels, notices)


def _check(spec: Any, opened: str, known: str, name: str) -> None:
    """Refuse what must not or cannot be decoded, going by the header."""
    width, height = spec.width, spec.height
    if opened != known:
        raise InputError(name, f"it starts like a {known} image, but is none", READABLE)
    if spec.deep:
        raise InputError(name, "it is a deep image, with many samples a pixel", "flatten it")
    if width <= 0 or height <= 0 or not 0 < spec.nchannels <= _MOST_CHANNELS or spec.depth > 1:
        cause = f"its size of {width} x {height} pixels, {spec.nchannels} channels cannot be used"
        raise InputError(name, cause, "export it as a plain image")
    if width * height > _LARGEST:
        cause = f"its {width} x {height} pixels are more than the {_LARGEST} that are read"
        raise InputError(name, cause, "scale it down, or split it")
    kinds = {str(kind) for kind in (spec.channelformats or (spec.format,))}
    if not kinds <= _STORED.keys() or (len(kinds) > 1 and not kinds <= {"half", "float"}):
        raise InputError(name, f"its samples are {' and '.join(sorted(kinds))}", _EXPORT)
    colour_space = spec.get_string_attribute("tiff:ColorSpace")
    if "CMYK" in colour_space.upper():
        raise InputError(name, "its colours are the inks of print (CMYK)", "convert it to RGB")
    if colour_space.endswith("LAB"):  # OpenImageIO makes a yellow of its white, and 8 bits of 16
        raise InputError(name, f"its colours are {colour_space}", "convert it to RGB")


def _picture(
    data: bytes, name: str, known: str, spec: Any, pixels: NDArray[Any], notices: tuple[str, ...]
) -> Picture:
    kinds = tuple(_STORED[str(kind)] for kind in (spec.channelformats or [spec.format] * spec.nchannels))
    channels = tuple(spec.channelnames)
    if known == "targa" and len(channels) == 2:  # OpenImageIO calls grey and alpha red and green there.
        channels = ("Y", "A")
    alpha = next((i for i, channel in enumerate(channels) if channel.lower() in ("a", "alpha")), None)
    colour = _colour_channels(channels, alpha)
    return Picture(
        name=name,
        pixels=pixels,
        channels=channels,
        colour=colour,
        alpha=alpha,
        encoding="linear" if pixels.dtype.kind == "f" else "srgb",
        stored=kinds[colour[0]],
        kinds=kinds,
        format=known,
        suffix=suffix_for(data, name),
        notices=notices,
        source=data,
        spec=spec,
    )


def _colour_channels(channels: tuple[str, ...], alpha: int | None) -> tuple[int, ...]:
    """Return red, green and blue by their names, or grey, or else the first channels that are not alpha."""
    lower = [channel.lower() for channel in channels]
    if all(letter in lower for letter in "rgb"):
        return tuple(lower.index(letter) for letter in "rgb")
    if "y" in lower and "x" not in lower:  # a luminance, and no coordinate
        return (lower.index("y"),)
    others = [i for i in range(len(channels)) if i != alpha] or [0]
    return tuple(others[:3]) if len(others) >= 3 else (others[0],)


def _damaged(name: str, known: str, error: str, path: Path) -> InputError:
    lines = [line.strip() for line in error.replace(str(path), "it").splitlines() if line.strip()]
    shown = "".join(c if c.isprintable() else "?" for c in lines[0][:150]) if lines else "no reason given"
    if any(word in shown for word in _NOT_BUILT_IN):
        cause = (
            f"this build of OpenImageIO does not read how the {label_of(known)} image is compressed ({shown})"
        )
        return InputError(name, cause, "save it without compression, or with another one")
    return InputError(
        name,
        f"the {label_of(known)} image is damaged or cut off ({shown})",
        "export it anew",
    )
