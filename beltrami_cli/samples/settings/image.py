"""What smoothing of images is told, with the defaults; light enough for the command line to import."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beltrami_cli.errors import UsageError


@dataclass(frozen=True)
class ImageSettings:
    """The surface that an image lies on, and where it has holes.

    Attributes
    ----------
    height : str or None
        Path of an image of heights over the plane, of the same size: the surface (x, y, `height_scale` * height), in
        pixels.
    height_scale : float
        Pixels per unit of height. Integers are taken as 0 to 1, floats as they are.
    positions : str or None
        Path of an image of places in space, of the same size, with the channels x, y, z (or red, green, blue).
    mask : str or None
        Path of an image of the same size that is zero at holes.

    Raises
    ------
    UsageError
        If the height scale is not finite, or of no use, or two surfaces are given.
    """

    height: str | None = None
    height_scale: float = 1.0
    positions: str | None = None
    mask: str | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.height_scale):
            raise UsageError(f"height_scale is {self.height_scale}, but must be a finite number")
        if self.height is not None and self.positions is not None:
            raise UsageError("height and positions are two surfaces for one image; give one of them")
        if self.height is None and self.height_scale != ImageSettings.height_scale:
            raise UsageError("height_scale is of the heights that --height names; add --height")

    @property
    def given(self) -> tuple[str, ...]:
        """Return the options that are set, for messages."""
        return tuple(
            f"--{name}" for name in ("height", "positions", "mask") if getattr(self, name) is not None
        )
