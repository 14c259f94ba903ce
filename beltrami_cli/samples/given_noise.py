"""Noise that is given for each sample: standard deviations in a file, or a frame that shows nothing besides noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.samples.guides import read_map, read_table, require_finite, require_size

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Float32s, Float64s, Int64s
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture

# Pixels a side of the squares in which the deviation of a frame is measured: with 289 it is known to 4 %.
_AROUND = 17


def noise_of_pixels(
    kernel: KernelParameters, pictures: Sequence[Picture], pixels: Int64s, access: Access
) -> Float32s | None:
    """Read the standard deviations of all pixels, shape (H, W, K), checked at some; None if no file has them."""
    given = kernel.given_noise
    if given is None or not given.source:
        return None
    if given.kind == "attribute":
        raise UsageError(f"noise is of the attribute {given.source}, which only vertices have; name an image")
    if len(pictures) != 1:
        raise UsageError(
            f"{given.source} is the noise of one of {len(pictures)} textures; choose it by --texture"
        )
    image = read_map(given.source, access)
    require_size(image, pictures[0].pixels.shape[:2], given.source, pictures[0].name)
    if given.kind == "frame":
        image = deviation_in_frame(image)
    _check(image.reshape(-1, image.shape[2])[pixels], given.source, "pixel")
    return image


def noise_of_vertices(kernel: KernelParameters, document: Document, access: Access) -> Float32s | None:
    """Read the standard deviations of vertices, shape (V, K); None if neither a file nor an attribute has them."""
    given = kernel.given_noise
    if given is None or not given.source:
        return None
    if given.kind == "frame":
        raise UsageError(
            f"{given.source} is a frame of pixels, but vertices are smoothed; name their deviations"
        )
    if given.kind == "attribute":
        values = document.attribute(given.source)
    else:
        values = read_table(given.source, len(document.painted().positions), document.name, access)
    _check(values, given.source, "vertex")
    return values.astype(np.float32)


def deviation_in_frame(frame: Float32s) -> Float32s:
    """Return the local standard deviation of a frame without a scene, (H, W, K); light may fall off across it."""
    from scipy.ndimage import uniform_filter

    size = (_AROUND, _AROUND, 1)
    residual = frame - uniform_filter(frame, size, mode="reflect")
    return np.asarray(np.sqrt(uniform_filter(np.square(residual), size, mode="reflect").clip(0)), np.float32)


def _check(deviations: Float32s | Float64s, name: str, row: str) -> None:
    require_finite(deviations, name, row)
    low, high = deviations.min(initial=0), deviations.max(initial=0)
    if low < 0 or high > 1:
        extreme = f"down to {low:g}" if low < 0 else f"up to {high:g}"
        cause = f"its values go {extreme}, but standard deviations are from 0 to a full scale of 1"
        raise InputError(name, cause, "divide them by 255 if they are of 255")
