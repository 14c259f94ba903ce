"""Alpha of images: whether colours are multiplied by it, and what they are without it."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.sample_types import full_scale_one

_MIN_OPACITY = 1 / 1024  # that colours are divided by
_MIN_STEPS = 16  # of opacity, for colours of 4 bits


def is_associated(image: DecodedImage) -> bool:
    """Whether alpha is multiplied into the stored colours, as it is in EXR files and may be in TIFF files."""
    if image.alpha is None or image.format not in ("openexr", "tiff"):
        return False
    return not (image.format == "tiff" and image.spec.get_int_attribute("oiio:UnassociatedAlpha"))


def without_alpha(image: DecodedImage, values: Float32s) -> Float32s:
    """Return channels of full scale 1, shape (..., C), with colours divided by alpha, except where it is nearly 0."""
    if not is_associated(image):
        return values
    straight = values.copy()
    opacity = values[..., image.alpha]
    for channel in image.colour:
        np.divide(values[..., channel], opacity, out=straight[..., channel], where=opacity >= _MIN_OPACITY)
    return straight


def supplies_colour(image: DecodedImage, opacity: Array) -> Bools:
    """Return from their stored opacity which pixels have a colour: all but transparent ones."""
    if not is_associated(image):
        return np.asarray(opacity != 0)
    steps = np.inf if opacity.dtype.kind == "f" else np.iinfo(opacity.dtype).max
    share = full_scale_one(opacity)
    return np.asarray((share >= max(_MIN_OPACITY, _MIN_STEPS / steps)) & np.isfinite(share))
