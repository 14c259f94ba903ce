"""Limits on how far two files may differ, and what breaks them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError, UsageError

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


def judge(parts: Iterable[Mapping[str, Any]], limits: Limits, test: str) -> tuple[list[Verdict], list[str]]:
    """Hold the figures of each part to the limits.

    Parameters
    ----------
    parts : iterable of mapping
        Figures as `figures` gives them, with "name". What has no samples is held to nothing.
    limits : Limits
        What to keep to.
    test : str
        The file that is judged, for messages.

    Returns
    -------
    verdicts : list of Verdict
        One for each limit and part; none for steps over seams where there is no seam.
    notices : list of str
        What is kept because there is nothing that could break it, one sentence each.

    Raises
    ------
    InputError
        If a limit cannot be measured for a part: what nobody can check must not pass.
    """
    held = [part for part in parts if part["samples"]]
    verdicts: list[Verdict] = []
    for limit, allowed in vars(limits).items():
        if allowed is None:
            continue
        for part in held:
            if limit == "max_seam_jump" and part["near_seams"] is None:
                continue  # nothing can jump
            if not _can_tell(part, limit):
                option = f"--{limit.replace('_', '-')}"
                raise InputError(test, f"{part['name']}: {option} {_WITHOUT[limit]}", _REMEDY)
            measured = _measured(part, limit)
            kept = measured is None or (
                measured >= allowed if limit.startswith("min") else measured <= allowed
            )
            verdicts.append(Verdict(limit, part["name"], allowed, measured, kept))
    seamless = limits.max_seam_jump is not None and all(part["near_seams"] is None for part in held)
    return verdicts, ["--max-seam-jump is kept, because there is no seam"] if seamless else []


_WITHOUT = {
    "min_ssim": "cannot be tested without a picture in which a window of 11 x 11 pixels counts",
    "max_delta_e": "cannot be tested where the numbers are not grey, or red, green and blue, in sRGB or linear light",
    "max_seam_jump": "cannot be tested where no chart has three texels in a row on either side of a seam",
}
_REMEDY = "leave that limit out, or choose what has it with --on, --slots, --texture, --channels or --space"


def _can_tell(part: Mapping[str, Any], limit: str) -> bool:
    if limit == "min_psnr":
        return True
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
