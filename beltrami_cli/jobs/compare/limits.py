"""Limits on the differences of two files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from beltrami_cli.errors import InputError
from beltrami_cli.jobs.compare.figures import Figures, PartFigures
from beltrami_cli.jobs.compare.same_model import ROUNDED_MOVE, Moves
from beltrami_cli.jobs.settings import Limits


@dataclass(frozen=True)
class _LimitedFigure:
    """A figure that a limit is for."""

    read: Callable[[Figures], float | None]
    missing: str | None = None  # where there is no such figure; None: it is infinite there
    only_with_seams: bool = False


def _mean_delta_e(figures: Figures) -> float | None:
    return None if figures["delta_e"] is None else figures["delta_e"]["mean"]


def _seam_jump_change(figures: Figures) -> float | None:
    return None if figures["seam_jump"] is None else figures["seam_jump"]["change"]


_FIGURES = {
    "min_psnr": _LimitedFigure(lambda figures: figures["psnr"]),
    "min_ssim": _LimitedFigure(
        lambda figures: figures["ssim"], "without an image in which a window of 11 x 11 pixels counts"
    ),
    "max_delta_e": _LimitedFigure(
        _mean_delta_e, "where the numbers are not grey, or red, green and blue, in sRGB or linear light"
    ),
    "max_seam_jump": _LimitedFigure(
        _seam_jump_change,
        "where no chart has three texels in a row on either side of a seam",
        only_with_seams=True,
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


def check_limits(parts: Sequence[PartFigures], limits: Limits, test: str) -> tuple[list[Verdict], list[str]]:
    """Hold the figures of each part that has samples to the limits; return notices of what nothing can break."""
    compared = [part for part in parts if part["samples"] and not part["identical"]]
    with_seams = [part for part in compared if part["near_seams"] is not None]
    verdicts = list[Verdict]()
    for limit, figure in _FIGURES.items():
        allowed: float | None = getattr(limits, limit)
        if allowed is not None:
            limited = with_seams if figure.only_with_seams else compared
            verdicts += [_verdict(limit, figure, part, allowed, test) for part in limited]
    is_seamless = limits.max_seam_jump is not None and not with_seams
    return verdicts, ["--max-seam-jump is kept, because there is no seam"] if is_seamless else []


def _verdict(limit: str, figure: _LimitedFigure, part: PartFigures, allowed: float, test: str) -> Verdict:
    """Hold a figure to its limit; InputError if there is no such figure, since an unchecked limit must not pass."""
    measured = figure.read(part)
    if measured is None and figure.missing is not None:
        option = f"--{limit.replace('_', '-')}"
        raise InputError(test, f"{part['name']}: {option} cannot be tested {figure.missing}", _REMEDY)
    sign = 1 if limit.startswith("min") else -1
    kept = measured is None or sign * measured >= sign * allowed
    return Verdict(limit, part["name"], allowed, measured, kept)


def check_moves(moves: Moves, limits: Limits) -> list[Verdict]:
    """Check the geometry against its limit; if only other limits are given, against the rounding of text."""
    if all(allowed is None for allowed in vars(limits).values()):
        return []
    allowed = ROUNDED_MOVE if limits.max_move is None else limits.max_move
    return [Verdict("max_move", "geometry", allowed, moves.largest, moves.largest <= allowed)]
