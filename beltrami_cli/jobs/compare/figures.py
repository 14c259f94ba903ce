"""The figures that say how compared colours differ, and limits on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.jobs.compare.models import ROUNDED_MOVE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
    from beltrami_cli.jobs.compare.models import Moves
    from beltrami_cli.jobs.settings import Limits

_FIGURES = {"min_psnr": "psnr", "min_ssim": "ssim", "max_delta_e": "delta_e", "max_seam_jump": "seam_jump"}
_WITHIN = {"max_delta_e": "mean", "max_seam_jump": "change"}
_WITHOUT = {
    "min_ssim": "cannot be tested without a picture in which a window of 11 x 11 pixels counts",
    "max_delta_e": "cannot be tested where the numbers are not grey, or red, green and blue, in sRGB or linear light",
    "max_seam_jump": "cannot be tested where no chart has three texels in a row on either side of a seam",
}
_REMEDY = "leave that limit out, or choose what has it with --on, --slots, --texture, --channels or --space"


@dataclass(frozen=True)
class SeamJumps:
    """How far colours jump where the surface goes on in another chart, at K places."""

    # (K,): the difference of the colours that both sides have at the seam, mean over channels, full scale 1.
    reference: Float64s
    test: Float64s


@dataclass(frozen=True)
class ComparedColours:
    """A texture, an image, or the vertices of a mesh, in two files."""

    name: str
    kind: Literal["vertices", "texture", "image"]
    reference: Float32s  # (S, N): their colours, full scale 1
    test: Float32s
    index: Int64s  # (S,) or (S, 2): the vertex, or column and row
    weights: Float64s  # (S,): what each counts
    delta_e: Float64s | None  # (S,): CIEDE2000 differences, where the numbers are colours
    ssim: float | None = None  # structural similarity, of images and textures
    # (S,): within 4 texels of a seam, or at a place where the file splits vertices; None: no seams.
    near_seams: Bools | None = None
    jumps: SeamJumps | None = None
    size: tuple[int, int] | None = None  # rows and columns of an image or texture
    # Whether it has the same colours in both, beside a part that is measured; of a texture they are not taken then.
    is_identical: bool = False
    other_opacity: bool = False  # whether opacity differs, which is not measured

    def squares(self) -> Float64s:
        """Return the squared error of each sample, mean over its channels, shape (S,)."""
        return np.asarray(np.square(self.test.astype(np.float64) - self.reference).mean(axis=1), np.float64)

    def described(self) -> dict[str, object]:
        """Return what it is and its figures, in JSON types."""
        own = {"name": self.name, "kind": self.kind, "identical": self.is_identical}
        return {**own, **figures([self])}

    def worst(self) -> dict[str, object]:
        """Return where the largest error in any channel is, and what it is, in JSON types; empty without samples."""
        errors = np.abs(self.test - self.reference).max(axis=1)
        if not errors.size:
            return {}
        at = int(errors.argmax())
        place: dict[str, object] = {"part": self.name}
        names = ("vertex",) if self.index.ndim == 1 else ("x", "y")
        place |= dict(zip(names, np.atleast_1d(self.index[at]).tolist(), strict=True))
        return {
            **place,
            "error": float(errors[at]),
            "delta_e": None if self.delta_e is None else float(self.delta_e[at]),
            "reference": self.reference[at].tolist(),
            "test": self.test[at].tolist(),
        }


def figures(parts: Sequence[ComparedColours]) -> dict[str, object]:
    """Compute the figures of one or several parts taken together, in JSON types; None where there are none."""
    # PSNR in dB: 10 log10(1 / mean squared error) over samples and channels.
    weights = np.concatenate([part.weights for part in parts])
    squares = np.concatenate([part.squares() for part in parts])
    structured = [(part.ssim, float(part.weights.sum())) for part in parts if part.ssim is not None]
    total = sum(weight for _, weight in structured)
    worst = [found for found in (part.worst() for part in parts) if found]
    return {
        "samples": len(weights),
        "psnr": psnr(squares, weights),
        "ssim": sum(value * weight for value, weight in structured) / total if total else None,
        "delta_e": _delta_e([part for part in parts if part.delta_e is not None]),
        "worst": max(worst, key=lambda found: float(str(found["error"])), default=None),
        "near_seams": _near_seams(parts),
        "seam_jump": _jumps([part.jumps for part in parts if part.jumps is not None]),
    }


def psnr(squares: Float64s, weights: Float64s) -> float | None:
    """Return the peak signal-to-noise ratio in dB for a full scale of 1; None if nothing differs."""
    total = float(weights.sum())
    mean = float(weights @ squares) / total if total > 0 else 0.0
    return -10 * math.log10(mean) if mean > 0 else None


def _delta_e(parts: Sequence[ComparedColours]) -> dict[str, float] | None:
    values = [part.delta_e for part in parts if part.delta_e is not None]
    weights = np.concatenate([part.weights for part in parts]) if values else np.zeros(0)
    if not weights.sum() > 0:
        return None
    every = np.concatenate(values)
    order = np.argsort(every)
    share = np.cumsum(weights[order]) / weights.sum()
    at = min(int(np.searchsorted(share, 0.95)), len(every) - 1)
    return {
        "mean": float(weights @ every / weights.sum()),
        "p95": float(every[order][at]),
        "worst": float(every.max()),
    }


def _near_seams(parts: Sequence[ComparedColours]) -> dict[str, object] | None:
    chosen = [(part, part.near_seams) for part in parts if part.near_seams is not None]
    count = sum(int(np.count_nonzero(near)) for _, near in chosen)
    if not count:
        return None
    weights = np.concatenate([part.weights[near] for part, near in chosen])
    squares = np.concatenate([part.squares()[near] for part, near in chosen])
    looks = [(part.delta_e[near], part.weights[near]) for part, near in chosen if part.delta_e is not None]
    total = sum(weight.sum() for _, weight in looks)
    mean = float(sum(value @ weight for value, weight in looks) / total) if total > 0 else None
    return {"samples": count, "psnr": psnr(squares, weights), "delta_e": mean}


def _jumps(jumps: Sequence[SeamJumps]) -> dict[str, object] | None:
    reference = np.concatenate([jump.reference for jump in jumps]) if jumps else np.zeros(0)
    if not reference.size:
        return None
    test = np.concatenate([jump.test for jump in jumps])
    return {
        "steps": len(reference),
        "reference": float(reference.mean()),
        "test": float(test.mean()),
        "change": float((test - reference).mean()),
    }


@dataclass(frozen=True)
class Verdict:
    """How one part kept to one limit."""

    limit: str
    part: str
    allowed: float
    measured: float | None  # None: infinite, as the PSNR of equal colours
    kept: bool


def check_limits(
    parts: Iterable[Mapping[str, Any]], limits: Limits, test: str
) -> tuple[list[Verdict], list[str]]:
    """Hold the figures of each part that has samples to the limits; return notices of what nothing can break."""
    # A limit that cannot be measured raises InputError: what nobody can check must not pass.
    held = [part for part in parts if part["samples"] and not part.get("identical")]
    verdicts: list[Verdict] = []
    for limit, allowed in vars(limits).items():
        if allowed is None or limit not in _FIGURES:
            continue
        for part in held:
            if limit == "max_seam_jump" and part["near_seams"] is None:
                continue  # nothing can jump
            figure = part[_FIGURES[limit]]
            if figure is None and limit != "min_psnr":
                option = f"--{limit.replace('_', '-')}"
                raise InputError(test, f"{part['name']}: {option} {_WITHOUT[limit]}", _REMEDY)
            measured = float(figure[_WITHIN[limit]]) if limit in _WITHIN else figure
            kept = measured is None or (
                measured >= allowed if limit.startswith("min") else measured <= allowed
            )
            verdicts.append(Verdict(limit, part["name"], allowed, measured, kept))
    seamless = limits.max_seam_jump is not None and all(part["near_seams"] is None for part in held)
    return verdicts, ["--max-seam-jump is kept, because there is no seam"] if seamless else []


def check_moves(moves: Moves, limits: Limits) -> list[Verdict]:
    """Hold the geometry to its limit; where there is none, but others, to what rounding explains."""
    if all(allowed is None for allowed in vars(limits).values()):
        return []
    allowed = ROUNDED_MOVE if limits.max_move is None else limits.max_move
    return [Verdict("max_move", "geometry", allowed, moves.largest, moves.largest <= allowed)]
