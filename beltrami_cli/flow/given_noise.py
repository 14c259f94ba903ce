"""Noise that the user gives, as a number or as a file."""

from __future__ import annotations

import re
from dataclasses import dataclass

from beltrami_cli.quantities import unambiguous_amount_in

_CAMERA = re.compile(r"shot:([^,]+),read:([^,]+)")

# A file of standard deviations is recognised by its extension, any other source by its prefix.
_SOURCE = re.compile(r"(?:(frame|attribute):)?((?(1).+|.+\.[A-Za-z]\w*))")


@dataclass(frozen=True)
class GivenNoise:
    """Noise that the user gives: a standard deviation, or shot and read noise of full scale 1 in linear light."""

    sigma: float = 0.0
    shot: float = 0.0
    read: float = 0.0
    source: str = ""  # file or vertex attribute with a value per sample
    kind: str = ""  # of the source: "frame", "attribute", or else standard deviations

    @property
    def is_by_level(self) -> bool:
        """Whether the noise depends on the level of colours."""
        return self.shot > 0 or self.read > 0

    def in_unit(self, unit: float, of_light: float) -> str:
        """Write the noise of colours that are divided by `unit`; `of_light` divides linear light."""
        if not self.is_by_level:
            return f"{100 * min(1.0, self.sigma / unit)!r}%"
        # var(L / u) = (A / u) (L / u) + (B / u)^2, and L is light
        shot, read = (min(1.0, each / of_light) for each in (self.shot, self.read))
        return f"shot:{shot!r},read:{read!r}"


_NOISE_FORMS = (
    "a number of 255 such as 12 or 0.9/255, a share of full scale such as 4.7%, "
    "shot:A,read:B such as shot:0.01,read:0.005, or a file of standard deviations such as sigma.exr, "
    "frame:FILE or attribute:NAME"
)


def given_noise(text: str) -> GivenNoise:
    """Read "12" or "12/255" of 255, "4.7%" of full scale, "shot:A,read:B", or a source; or ValueError."""
    camera, source = _CAMERA.fullmatch(text.strip()), _SOURCE.fullmatch(text)
    if camera is None:
        if source is None:
            return GivenNoise(unambiguous_amount_in(text, _NOISE_FORMS))
        return GivenNoise(source=source[2], kind=source[1] or "")
    try:
        shot, read = map(float, camera.groups())
    except ValueError:
        raise ValueError(f"is {text!r}, but must be {_NOISE_FORMS}") from None
    if not (0 <= shot <= 1 and 0 <= read <= 1):
        raise ValueError(f"is {text!r}, but shot and read are between 0 and 1, of full scale")
    return GivenNoise(shot=shot, read=read)


def file_of_noise(text: str) -> str:
    """Return the file that a value of `noise` names; empty if it names none."""
    source = _SOURCE.fullmatch(text)
    return "" if source is None or source[1] == "attribute" else source[2]
