"""Limits on the differences of two files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from beltrami_cli.errors import InputError
from beltrami_cli.jobs.compare.same_model import ROUNDED_MOVE, Moves
from beltrami_cli.jobs.settings import Limits


class _Figure(NamedTuple):
    key: str
    inner: str | None = None  # key within the figure; None: it is a number
    missing: str = ""  # where it is missing; empty: it is then infinite


_FIGURES = {
    "min_psnr": _Figure("psnr"),
    "min_ssim": _Figure("ssim", None, "without a picture in which a window of 11 x 11 pixels counts"),
    "max_delta_e": _Figure(
        "delta_e", "mean", "where the numbers are not grey, or red, green and blue, in sRGB or linear light"
    ),
    "max_seam_jump": _Figure(
        "seam_jump", "change", "where no chart has three texels in a row on either side of a seam"
    ),
}
_REMEDY = "leave that limit out, or choose what has it with --on, --slots, --texture, --channels or --space"


@dataclass(frozen=True)
class Verdict:
    """The verdict on one part and one limit."""

    limit: str
    part: str
    allowed: float
    measured: float | None  # None: infinite, as the PSNR of equal colours
    kept: bool


def check_limits(
    parts: Iterable[Mapping[str, Any]], limits: Limits, test: str
) -> tuple[list[Verdict], list[str]]:
    """Hold the figures of each part that has samples to the limits; return notices of what nothing can break."""
    # A limit that cannot be measured raises InputError: an unchecked limit must not pass.
    compared = [part for part in parts if part["samples"] and not part.get("identical")]
    verdicts: list[Verdict] = []
    for limit, (key, inner, missing) in _FIGURES.items():
        allowed = getattr(limits, limit)
        if allowed is None:
            continue
        for part in compared:
            if limit == "max_seam_jump" and part["near_seams"] is None:
                continue  # nothing can jump
            figure = part[key]
            if figure is None and missing:
                option = f"--{limit.replace('_', '-')}"
                raise InputError(test, f"{part['name']}: {option} cannot be tested {missing}", _REMEDY)
            measured = figure if inner is None else float(figure[inner])
            sign = 1 if limit.startswith("min") else -1
            kept = measured is None or sign * measured >= sign * allowed
            verdicts.append(Verdict(limit, part["name"], allowed, measured, kept))
    seamless = limits.max_seam_jump is not None and all(part["near_seams"] is None for part in compared)
    return verdicts, ["--max-seam-jump is kept, because there is no seam"] if seamless else []


def check_moves(moves: Moves, limits: Limits) -> list[Verdict]:
    """Check the geometry against its limit; if only other limits are given, against the rounding of text."""
    if all(allowed is None for allowed in vars(limits).values()):
        return []
    allowed = ROUNDED_MOVE if limits.max_move is None else limits.max_move
    return [Verdict("max_move", "geometry", allowed, moves.largest, moves.largest <= allowed)]
