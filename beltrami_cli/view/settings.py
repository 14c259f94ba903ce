"""The parameters of pictures with their defaults; light enough for the command line to import."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

from beltrami_cli.errors import UsageError

Axis = Literal["x", "y", "z"]

# Degrees to the right of the front, and upwards.
VIEWS = {
    "front": (0.0, 0.0),
    "back": (180.0, 0.0),
    "right": (90.0, 0.0),
    "left": (-90.0, 0.0),
    "top": (0.0, 90.0),
    "bottom": (0.0, -90.0),
    "three-quarter": (35.0, 20.0),
}
BACKGROUNDS = {"white": "#ffffff", "grey": "#808080", "black": "#000000"}
MOST_PIXELS = 1 << 26
LONGEST_SIDE = 16384


@dataclass(frozen=True)
class Crop:
    """An enlarged detail."""

    side: float = 0.2  # of the square, as a fraction of the shorter side of the view
    # Its middle in fractions of the view's width and height, from the upper left; None: where there is most to see.
    centre: tuple[float, float] | None = None

    @classmethod
    def parse(cls, text: str) -> Crop:
        """Read ``auto``, ``auto,SIDE``, ``X,Y`` or ``X,Y,SIDE``; UsageError for anything else."""
        words = [word.strip() for word in text.split(",")]
        automatic = words[0] == "auto"
        try:
            numbers = [float(word) for word in words[automatic:]]
        except ValueError:
            numbers = [-1.0]
        fixed = 0 if automatic else 2
        in_range = all(0 <= number <= 1 for number in numbers)
        if len(numbers) not in (fixed, fixed + 1) or not in_range or numbers[fixed:] == [0.0]:
            raise UsageError(f"crop is {text}, but must be X,Y or X,Y,SIDE or auto, with numbers from 0 to 1")
        side = numbers[fixed] if len(numbers) > fixed else cls.side
        return cls(side, None if automatic else (numbers[0], numbers[1]))


@dataclass(frozen=True)
class RenderSettings:
    """The camera, the light and the layout of a picture; UsageError if a value is out of its range."""

    size: tuple[int, int] = (640, 640)  # width and height of each view in pixels
    azimuth: float = 0.0  # of the eye, in degrees to the right around the model from its front
    elevation: float = 0.0  # of the eye, in degrees upwards
    up: Axis = "y"  # the axis of the model that points up
    fov: float = 30.0  # field of view in degrees along the shorter side; 0: parallel rays
    zoom: float = 1.0  # how much larger than what fits the view
    lit: bool = False  # by a lamp that shows the shape; otherwise colours are as they are
    background: str = "auto"  # a name, #rrggbb or transparent; auto: white, or grey behind what is white
    slot: str = "baseColor"  # the textures that are shown
    on: Literal["auto", "vertices", "texture"] = "auto"  # what is shown of models that have both
    turntable: int = 0  # views all around in equal steps; 0: one view
    crops: tuple[Crop, ...] = ()  # details, drawn enlarged below each view
    labels: tuple[str, ...] | None = None  # one for each file; None: names of several files; empty: none
    stacked: bool = False  # files below each other, and not side by side

    def __post_init__(self) -> None:
        if min(self.size) < 16 or max(self.size) > LONGEST_SIDE:
            raise UsageError(f"size is {self.size[0]}x{self.size[1]}, but sides must be 16 to {LONGEST_SIDE}")
        if self.up not in get_args(Axis):
            raise UsageError(f"up is {self.up}, but must be x, y or z")
        if not 0 <= self.fov <= 120:
            raise UsageError(f"field of view is {self.fov:g}, but must be between 0 and 120 degrees")
        if not 0.01 <= self.zoom <= 1000:
            raise UsageError(f"zoom is {self.zoom:g}, but must be between 0.01 and 1000")
        if not all(abs(angle) <= 36000 for angle in (self.azimuth, self.elevation)):
            raise UsageError("azimuth and elevation must be finite numbers of degrees")
        if not 0 <= self.turntable <= 360:
            raise UsageError(f"turntable is {self.turntable}, but must be between 0 and 360 views")
        if len(self.crops) > 5:
            raise UsageError(f"there are {len(self.crops)} crops, but at most 5 can be shown")
        self.background_colour()

    def background_colour(self) -> tuple[float, float, float] | None:
        """Return the background as display values, 0 to 1; None: transparent, or what suits the models."""
        if self.background in ("auto", "transparent"):
            return None
        digits = re.fullmatch(r"#([0-9a-fA-F]{6})", BACKGROUNDS.get(self.background, self.background))
        if digits is None:
            names = ", ".join(("auto", *BACKGROUNDS, "transparent"))
            raise UsageError(f"background is {self.background}, but must be {names} or #rrggbb")
        red, green, blue = bytes.fromhex(digits[1])
        return red / 255, green / 255, blue / 255


DEFAULT_RENDER = RenderSettings()
