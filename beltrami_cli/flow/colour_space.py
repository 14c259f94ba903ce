"""The spaces in which colour distances and averages may be taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float32s
    from beltrami_cli.flow.parameters import Space
    from beltrami_cli.surface.records import Encoding

# B. Ottosson, "A perceptual color space for image processing" (2020): linear sRGB -> cone response -> Lab.
_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def to_space(colours: Float32s, encoding: Encoding, space: Space) -> Float32s:
    """Convert stored colours, shape (S, C), full scale 1, to the working space; "data" keeps the numbers."""
    if space in ("data", encoding):
        return colours
    if space == "oklab":
        _require_three(colours)
        linear = srgb_to_linear(colours) if encoding == "srgb" else colours
        return np.asarray(np.cbrt(linear @ _CONES.T) @ _LAB.T, np.float32)
    return np.asarray(srgb_to_linear(colours) if space == "linear" else linear_to_srgb(colours), np.float32)


def from_space(colours: Float32s, encoding: Encoding, space: Space) -> Float32s:
    """Convert working colours, shape (S, C), back to what the file stores; the inverse of `to_space`."""
    if space in ("data", encoding):
        return colours
    if space == "oklab":
        _require_three(colours)
        linear = (colours @ np.linalg.inv(_LAB).T) ** 3 @ np.linalg.inv(_CONES).T
        converted = linear_to_srgb(linear) if encoding == "srgb" else linear
    else:
        converted = linear_to_srgb(colours) if encoding == "srgb" else srgb_to_linear(colours)
    return np.asarray(converted, np.float32)


def _require_three(colours: Float32s) -> None:
    if colours.shape[1] != 3:
        raise UsageError(
            f"the space oklab needs red, green and blue, but there are {colours.shape[1]} channels; "
            "choose --space srgb, linear or data"
        )
