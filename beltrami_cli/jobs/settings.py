"""The parameters of noise that is added, of new textures, and of comparisons.

Light enough for the command line to import.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Checked, described, parameter
from beltrami_cli.quantities import amount_in, share_in, unambiguous_amount_in

_SMALLEST_SIDE, _LARGEST_SIDE = 16, 16384  # of a texture: less is of no use, graphics cards take no more
BakeTo = Literal["texture", "vertices"]
Kind = Literal["gaussian", "salt-pepper", "speckle", "poisson", "white", "camera", "grain", "jpeg"]
_WITHOUT_SIGMA = ("camera", "jpeg")
_OF_ONE_KIND = {"shot": "camera", "read": "camera", "grain_size": "grain", "quality": "jpeg"}


@dataclass(frozen=True)
class NoiseSettings(Checked):
    """What noise is added; UsageError if a value is out of its range."""

    group: ClassVar[str] = "Noise"

    sigma: float | None = parameter(
        None,
        "How much, of full scale: 20 is 20/255, as `beltrami info` shows noise; or as 20/255, 1310/65535 or "
        "8%. Needed by all kinds but camera and jpeg.",
        kind=float, low=0, high=1, unit="shares of full scale", metavar="S", parse=unambiguous_amount_in, is_daily=True,
    )  # fmt: skip
    kind: Kind = parameter(
        "gaussian",
        "gaussian (or white): the same deviation everywhere; salt-pepper: black and white samples; speckle: "
        "proportional to the colour; poisson: to its square root; camera: shot and read noise through a Bayer "
        "mosaic; grain: correlated over neighbours; jpeg: what coding changes.",
        choices=get_args(Kind), is_daily=True,
    )  # fmt: skip
    seed: int = parameter(
        0, "The same seed gives the same noise, for any number of threads.", low=0, metavar="K", is_daily=True
    )
    shot: float = parameter(
        0.01, "Of a camera: A of the variance A L + B^2 of the light L, which is linear, 0 to 1.",
        low=0, high=1, metavar="A", is_daily=True,
    )  # fmt: skip
    read: float = parameter(
        0.005, "Of a camera: B of that variance, the deviation in the dark.",
        low=0, high=1, metavar="B", is_daily=True,
    )  # fmt: skip
    grain_size: float = parameter(
        2.0, "Of grain: its correlation length; samples further apart than this are hardly correlated.",
        low=1, high=64, unit="distances of samples", metavar="N", is_daily=True,
    )  # fmt: skip
    quality: int = parameter(
        85, "Of jpeg: the quality at which each image is coded, with colour at half the resolution (4:2:0).",
        low=1, high=100, metavar="Q", is_daily=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sigma is None and self.kind not in _WITHOUT_SIGMA:
            raise UsageError(f"--sigma says how much {self.kind} noise is added, such as --sigma 20; give it")
        for name, kind in _OF_ONE_KIND.items():
            if kind != self.kind and getattr(self, name) != getattr(type(self), name):
                option = name.replace("_", "-")
                raise UsageError(f"--{option} is of {kind} noise, not of {self.kind}; add --kind {kind}")

    @property
    def deviation(self) -> float:
        """`sigma`, or 0 where it means nothing."""
        return 0.0 if self.sigma is None else self.sigma


@described
@dataclass(frozen=True)
class BakeSettings(Checked):
    """How a new texture is made."""

    group: ClassVar[str] = "New textures"

    size: int | None = parameter(
        None, "Longest side of the new texture.", kind=int, low=_SMALLEST_SIDE, high=_LARGEST_SIDE, unit="texels",
        unset="two texels along an edge, at most 8192; or as in the old texture", metavar="N",
    )  # fmt: skip
    padding: int = parameter(
        4, "Distance between the charts of a new texture.", low=0, high=64, unit="texels", metavar="N"
    )
    keep_uv: bool = parameter(False, "Use the texture coordinates of INPUT rather than make new ones.")
    max_unwrap_faces: int = parameter(
        100_000,
        "The largest mesh to unwrap: 16 thousand triangles take some 7 s, 82 thousand 2 minutes, as the "
        "time grows faster than their number.",
        low=1, unit="triangles", metavar="COUNT", lifts_limit=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size is not None and self.size <= 4 * self.padding:
            raise UsageError(f"a size of {self.size} leaves no room between paddings of {self.padding}")


@dataclass(frozen=True)
class Limits(Checked):
    """What a comparison must keep to; None: anything goes. UsageError if nothing could keep to it."""

    group: ClassVar[str] = "Limits"

    min_psnr: float | None = parameter(
        None, "Lowest PSNR allowed.", kind=float, unit="dB", metavar="DB", is_daily=True
    )
    min_ssim: float | None = parameter(
        None, "Lowest structural similarity allowed; 1 is equal.",
        kind=float, high=1, metavar="S", is_daily=True,
    )  # fmt: skip
    max_delta_e: float | None = parameter(
        None, "Largest mean Delta E 2000 allowed.", kind=float, low=0, metavar="E", is_daily=True
    )
    max_seam_jump: float | None = parameter(
        None,
        "How much larger the mean colour step over seams may be than in REFERENCE: 1 is 1/255; or as 1/255 "
        "or 0.4%.",
        kind=float, metavar="X", parse=amount_in, is_daily=True,
    )  # fmt: skip
    max_move: float | None = parameter(
        None,
        "How far a vertex may be from its place in REFERENCE, such as 0.1%. With other limits alone, it may "
        "not move by more than rounding.",
        kind=float, low=0, unit="longest sides of the model", metavar="SHARE", parse=share_in,
    )  # fmt: skip
