"""Limits on how far two files may differ, and what breaks them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


@dataclass(frozen=True)
class Limits:
    """What a comparison must keep to; None: anything goes.

    Attributes
    ----------
    min_psnr : float or None
        In dB.
    min_ssim : float or None
        Structural similarity.
    max_delta_e : float or None
        Mean CIEDE2000 difference.
    max_seam_jump : float or None
        Mean colour step over seams in the test minus that in the reference, full scale 1.

    Raises
    ------
    UsageError
        If a limit is no finite number, or cannot be kept.
    """

    min_psnr: float | None = None
    min_ssim: float | None = None
    max_delta_e: float | None = None
    max_seam_jump: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not math.isfinite(value):
                raise UsageError(f"{name} is {value}, but must be a finite number")
        if self.max_delta_e is not None and self.max_delta_e < 0:
            raise UsageError(f"max_delta_e is {self.max_delta_e}, but no difference is below 0")
        if self.min_ssim is not None and self.min_ssim > 1:
            raise UsageError(f"min_ssim is {self.min_ssim}, but no similarity is above 1")


@dataclass(frozen=True)
class Verdict:
    """How one part kept to one limit.

    Attributes
    ----------
    limit : str
        Name of the limit.
    part : str
        Which part.
    allowed : float
        The limit.
    measured : float or None
        None: infinite, as the PSNR of equal colours.
    kept : bool
        Whether it is kept.
    """

    limit: str
    part: str
    allowed: float
    measured: float | None
    kept: bool


def judge(parts: Iterable[Mapping[str, Any]], limits: Limits) -> tuple[list[Verdict], list[str]]:
    """Hold the figures of each part to the limits.

    Parameters
    ----------
    parts : iterable of mapping
        Figures as `figures` gives them, with "name".
    limits : Limits
        What to keep to.

    Returns
    -------
    verdicts : list of Verdict
        One for each limit and part that it can be told for.
    notices : list of str
        Limits that can be told for no part.
    """
    parts = list(parts)
    verdicts: list[Verdict] = []
    notices: list[str] = []
    for limit, allowed in vars(limits).items():
        if allowed is None:
            continue
        told = [(part["name"], _measured(part, limit)) for part in parts if _can_tell(part, limit)]
        for name, measured in told:
            kept = measured is None or (
                measured >= allowed if limit.startswith("min") else measured <= allowed
            )
            verdicts.append(Verdict(limit, name, allowed, measured, kept))
        if not told:
            notices.append(f"--{limit.replace('_', '-')} is not tested, because there is {_WITHOUT[limit]}")
    return verdicts, notices


_WITHOUT = {
    "min_psnr": "nothing to compare",
    "min_ssim": "no image, or no window of 11 x 11 pixels in one that the surface covers",
    "max_delta_e": "no colour but data",
    "max_seam_jump": "no seam",
}


def _can_tell(part: Mapping[str, Any], limit: str) -> bool:
    if limit == "min_psnr":
        return bool(part["samples"])
    return (
        part[{"min_ssim": "ssim", "max_delta_e": "delta_e", "max_seam_jump": "seam_jump"}[limit]] is not None
    )


def _measured(part: Mapping[str, Any], limit: str) -> float | None:
    if limit == "max_delta_e":
        return float(part["delta_e"]["mean"])
    if limit == "max_seam_jump":
        return float(part["seam_jump"]["change"])
    value = part["psnr" if limit == "min_psnr" else "ssim"]
    return None if value is None else float(value)
