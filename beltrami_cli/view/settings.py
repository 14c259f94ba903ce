"""The parameters of pictures, without imports that would slow the command line down."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Checked, parameter
from beltrami_cli.surface.slots import SLOTS

if TYPE_CHECKING:
    from beltrami_cli.layers.settings import SmoothSettings

Axis = Literal["x", "y", "z"]
Colour = tuple[float, float, float, float]  # display values and opacity from 0 to 1

# Directions of the eye in degrees: to the right of the front, and upwards.
VIEWS = {
    "front": (0.0, 0.0), "back": (180.0, 0.0), "right": (90.0, 0.0), "left": (-90.0, 0.0),
    "top": (0.0, 90.0), "bottom": (0.0, -90.0), "three-quarter": (35.0, 20.0),
}  # fmt: skip
BACKGROUNDS = {"white": "#ffffff", "grey": "#808080", "black": "#000000"}
_BACKGROUND = f"auto, {', '.join(BACKGROUNDS)}, transparent or #rrggbb"
MAX_PIXELS = 1 << 26
SHORTEST_SIDE, LONGEST_SIDE = 16, 16384
_MAX_DEGREES = 36000


@dataclass(frozen=True)
class Crop:
    side: float = 0.2  # as a fraction of the shorter side of the view
    # Centre in fractions of the view's width and height, from the upper left; None: where brightness varies most.
    centre: tuple[float, float] | None = None

    @classmethod
    def parse(cls, text: str) -> Crop:
        """Read ``auto``, ``auto,SIDE``, ``X,Y`` or ``X,Y,SIDE``; ValueError if it is none of these."""
        words = [word.strip() for word in text.split(",")]
        automatic = words[0] == "auto"
        try:
            numbers = [float(word) for word in words[automatic:]]
        except ValueError:
            numbers = [-1.0]
        fixed = 0 if automatic else 2
        in_range = all(0 <= number <= 1 for number in numbers)
        if len(numbers) not in (fixed, fixed + 1) or not in_range or numbers[fixed:] == [0.0]:
            raise ValueError(f"is {text}, but must be X,Y or X,Y,SIDE or auto, with numbers from 0 to 1")
        side = numbers[fixed] if len(numbers) > fixed else cls.side
        return cls(side, None if automatic else (numbers[0], numbers[1]))


def _size(text: str) -> tuple[int, int]:
    words = text.lower().split("x")
    if len(words) > 2 or not all(word.isascii() and word.isdigit() and len(word) < 19 for word in words):
        raise ValueError(f"is {text!r}, but must be a size such as 800 or 1280x720")
    return int(words[0]), int(words[-1])


@dataclass(frozen=True)
class RenderSettings(Checked):
    """How models and images are drawn; UsageError if a value is out of its range."""

    group: ClassVar[str] = "Pictures"

    size: tuple[int, int] = parameter(
        (640, 640), "Width and height of each view.",
        low=SHORTEST_SIDE, high=LONGEST_SIDE, unit="pixels", metavar="N|WxH", parse=_size,
        show=lambda size: "x".join(map(str, size)), is_daily=True,
    )  # fmt: skip
    view: str = parameter(
        "front", "Where the eye is; y points up, and the front looks along z, unless --up says otherwise.",
        choices=tuple(VIEWS), is_daily=True, of=("vertex colours", "textures"),
    )  # fmt: skip
    azimuth: float | None = parameter(
        None, "Position of the eye: around the model, to the right of its front.",
        kind=float, low=-_MAX_DEGREES, high=_MAX_DEGREES, unit="degrees", unset="of --view", metavar="DEGREES",
        of=("vertex colours", "textures"),
    )  # fmt: skip
    elevation: float | None = parameter(
        None, "Position of the eye: upwards; negative: from below.",
        kind=float, low=-_MAX_DEGREES, high=_MAX_DEGREES, unit="degrees", unset="of --view", metavar="DEGREES",
        of=("vertex colours", "textures"),
    )  # fmt: skip
    up: Axis = parameter(
        "y", "Which axis of the models points up: z in many scans and in CAD.",
        choices=get_args(Axis), of=("vertex colours", "textures"),
    )  # fmt: skip
    fov: float = parameter(
        30.0, "Field of view along the shorter side; 0: parallel rays.",
        low=0, high=120, unit="degrees", metavar="DEGREES", of=("vertex colours", "textures"),
    )  # fmt: skip
    zoom: float = parameter(1.0, "Magnification of the fitted view.", low=0.01, high=1000, metavar="FACTOR")
    lit: bool = parameter(
        False,
        "Light the shape, or show colours without light. Points are never lit.",
        flags=("--lit/--unlit",), is_daily=True, of=("vertex colours", "textures"),
    )  # fmt: skip
    background: str = parameter(
        "auto", "white, grey, black, #rrggbb, or transparent; auto: white, or grey behind pale models.",
        allowed=_BACKGROUND, metavar="COLOUR",
    )  # fmt: skip
    slot: str = parameter(
        "baseColor",
        "The material slot of the textures. All but baseColor and emissive are shown as their plain numbers.",
        choices=SLOTS, of=("textures",),
    )  # fmt: skip
    on: Literal["auto", "vertices", "texture"] = parameter(
        "auto",
        "Of models that have both: the texture or the vertex colours; auto: the texture.",
        choices=("auto", "vertices", "texture"), flags=("--show", "on"), of=("vertex colours", "textures"),
    )  # fmt: skip
    crops: tuple[Crop, ...] = parameter(
        (),
        "Draw an enlarged square detail below each view: its middle in fractions of the view from the "
        "upper left, and its side in fractions of the shorter side (0.2); auto: the place with most detail "
        "in the last file. Up to 5 times.",
        kind=Crop, flags=("--crop", "crops"), metavar="X,Y[,SIDE]|auto[,SIDE]", repeatable=True,
        parse=Crop.parse, is_daily=True,
    )  # fmt: skip
    labels: tuple[str, ...] | None = parameter(
        None, "Words above each view, once for each file.",
        kind=str, several=True, unset="the names of the files, if there are several",
        flags=("--label", "labels"), metavar="TEXT", repeatable=True, is_daily=True,
    )  # fmt: skip
    side_by_side: bool = parameter(
        True, "Place several files next to each other with one camera, or below each other.",
        flags=("--side-by-side/--stacked",),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.size) != 2:
            raise UsageError(f"size is {self.size}, but must be a width and a height")
        if len(self.crops) > 5:
            raise UsageError(f"there are {len(self.crops)} crops, but at most 5 can be shown")
        self.background_colour()

    @property
    def angles(self) -> tuple[float, float]:
        """Where the eye is, in degrees: to the right of the front, and upwards."""
        azimuth, elevation = VIEWS[self.view]
        return (
            azimuth if self.azimuth is None else self.azimuth,
            elevation if self.elevation is None else self.elevation,
        )

    def background_colour(self) -> Colour:
        """Return the background; "auto" is white until a picture is drawn."""
        if self.background == "transparent":
            return 1.0, 1.0, 1.0, 0.0
        name = "white" if self.background == "auto" else self.background
        digits = re.fullmatch(r"#([0-9a-fA-F]{6})", BACKGROUNDS.get(name, name))
        if digits is None:
            raise UsageError(f"background is {self.background}, but must be {_BACKGROUND}")
        red, green, blue = bytes.fromhex(digits[1])
        return red / 255, green / 255, blue / 255, 1.0


DEFAULT_RENDER = RenderSettings()


def parts_shown(settings: SmoothSettings) -> dict[str, Any]:
    """Return the values of `RenderSettings` that show what is smoothed with some settings."""
    return {"on": "vertices" if settings.on == "vertices" else "auto", "slot": settings.textures.slots[0]}
