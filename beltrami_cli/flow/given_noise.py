"""Noise that the user gives, as a number or as a file."""

from __future__ import annotations

import re
from dataclasses import dataclass

from beltrami_cli.quantities import unambiguous_amount_in

_CAMERA = re.compile(r"shot:([^,]+),read:([^,]+)")

_PREFIXED_SOURCE = re.compile(r"(frame|attribute):(.+)")
# A file of standard deviations is recognised by its extension.
_FILE = re.compile(r".+\.[A-Za-z]\w*")

_FORMS = (
    "a number of 255 such as 12 or 0.9/255, a share of full scale such as 4.7%, "
    "shot:A,read:B such as shot:0.01,read:0.005, or a file of standard deviations such as sigma.exr, "
    "frame:FILE or attribute:NAME"
)


@dataclass(frozen=True)
class GivenNoise:
    """Noise that the user gives: a standard deviation, or shot and read noise of full scale 1 in linear light."""

    sigma: float = 0.0
    shot: float = 0.0
    read: float = 0.0
    source: str = ""  # file or vertex attribute with a value per sample
    kind: str = ""  # of the source: "frame", "attribute", or else standard deviations

    @classmethod
    def parse(cls, text: str) -> GivenNoise:
        """Read "12" or "12/255" of 255, "4.7%" of full scale, "shot:A,read:B", or a source; or ValueError."""
        camera = _CAMERA.fullmatch(text.strip())
        if camera is None:
            kind, source = _source_in(text)
            return cls(source=source, kind=kind) if source else cls(unambiguous_amount_in(text, _FORMS))
        try:
            shot, read = map(float, camera.groups())
        except ValueError:
            raise ValueError(f"is {text!r}, but must be {_FORMS}") from None
        if not (0 <= shot <= 1 and 0 <= read <= 1):
            raise ValueError(f"is {text!r}, but shot and read are between 0 and 1, of full scale")
        return cls(shot=shot, read=read)

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


def file_of_noise(text: str) -> str:
    """Return the file that a value of `noise` names; empty if it names none."""
    kind, source = _source_in(text)
    return "" if kind == "attribute" else source


def _source_in(text: str) -> tuple[str, str]:
    """Return the kind of a source and its name, which is empty if the text names none."""
    prefixed = _PREFIXED_SOURCE.fullmatch(text)
    if prefixed is not None:
        return prefixed[1], prefixed[2]
    return "", text if _FILE.fullmatch(text) else ""
