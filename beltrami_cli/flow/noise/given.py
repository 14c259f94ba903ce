"""Noise that is given: of one standard deviation, that of a camera, or by a file for each sample."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from beltrami_cli.fields import number_in

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.flow.noise.model import VarianceStabiliser

_CAMERA = re.compile(r"shot:([^,]+),read:([^,]+)")

# A file of standard deviations is known by its extension.
_SOURCE = re.compile(r"(frame|attribute):(.+)|()(.+\.[A-Za-z]\w*)")

# Levels at which the noise of a camera is tabulated.
_LEVELS = 65

# The least relative standard deviation of samples, so that colours can be divided by it.
_LEAST_RELATIVE = 0.05


@dataclass(frozen=True)
class GivenNoise:
    """A standard deviation, or the shares of shot and read noise: of full scale 1 and linear light."""

    sigma: float = 0.0
    shot: float = 0.0
    read: float = 0.0
    source: str = ""  # the file, or the attribute of vertices, that has it for each sample
    kind: str = ""  # of the source: "frame", "attribute", or else standard deviations

    @property
    def is_by_level(self) -> bool:
        """Whether it depends on the level of colours."""
        return self.shot > 0 or self.read > 0

    def stabiliser(self) -> VarianceStabiliser:
        """Return what makes the noise of a camera the same at all levels of sRGB colours."""
        import numpy as np

        from beltrami_cli.flow.noise.model import VarianceStabiliser
        from beltrami_cli.surface.records import srgb_to_linear

        levels = np.linspace(0, 1, _LEVELS) ** 2  # denser where the encoding of colours is steep
        light = srgb_to_linear(levels).astype(np.float64)
        slopes = np.maximum(np.gradient(light, levels), 1 / 12.92)
        sigma = np.sqrt(self.shot * light + self.read**2) / slopes
        return VarianceStabiliser(levels, np.maximum(sigma, sigma.max() / 1000), np.ones(len(sigma)))


def given_noise(text: str) -> GivenNoise:
    """Read "12" or "12/255" of 255, "0.047" or "4.7%" of full scale, "shot:A,read:B", or a source; or ValueError."""
    camera, source = _CAMERA.fullmatch(text.strip()), _SOURCE.fullmatch(text)
    try:
        if camera:
            found = GivenNoise(shot=float(camera[1]), read=float(camera[2]))
        elif source:
            found = GivenNoise(source=source[2] or source[4], kind=source[1] or "")
        else:
            value, is_plain = number_in(text)
            found = GivenNoise(value / 255 if is_plain and value >= 1 else value)
    except ValueError:
        raise ValueError(
            f"is {text!r}, but must be a number of 255 such as 12, a share of full scale such as 0.047 or 4.7%, "
            "shot:A,read:B such as shot:0.01,read:0.005, or a file of standard deviations such as sigma.exr, "
            "frame:FILE or attribute:NAME"
        ) from None
    if not (0 <= found.sigma <= 1 and 0 <= found.shot <= 1 and 0 <= found.read <= 1):
        raise ValueError(f"is {text!r}, but noise is at least 0, and at most 255 or a full scale of 1")
    return found


def file_of_noise(text: str) -> str:
    """Return the file that a value of `noise` names; empty: none."""
    source = _SOURCE.fullmatch(text)
    return "" if source is None or source[1] == "attribute" else source[2] or source[4]


def relative_to_mean(deviations: Float32s) -> tuple[Float32s, Float64s]:
    """Return variances relative to their mean, shape (S, 1), and sigma by channel, of deviations of shape (S, K)."""
    import numpy as np

    variances = np.square(deviations, dtype=np.float64)
    sigma = np.sqrt(variances.mean(axis=0))
    mean = np.mean(np.square(sigma))
    if not mean > 0:
        return np.ones((len(deviations), 1), np.float32), sigma
    relative = np.maximum(variances.mean(axis=1, keepdims=True) / mean, _LEAST_RELATIVE**2)
    return relative.astype(np.float32), sigma
