"""The figures that say how compared colours differ, such as CIEDE2000 and structural similarity, and limits on them.

References
----------
.. [1] G. Sharma, W. Wu, E. Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test
   data, and mathematical observations", Color Research and Application 30 (2005), doi:10.1002/col.20070; the numbers
   of equations are of this paper, except for SSIM.
.. [2] IEC 61966-2-1:1999, sRGB: the primaries and the white point D65.
.. [3] CIE 15:2004, "Colorimetry": L*a*b*.
.. [4] Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, "Image quality assessment: from error visibility to structural
   similarity", IEEE Transactions on Image Processing 13 (2004), doi:10.1109/TIP.2003.819861: SSIM.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.jobs.compare.models import ROUNDED_MOVE, Moves
from beltrami_cli.jobs.job import Limits

# Linear sRGB -> XYZ [2]; rows add up to the white point.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_CUBE_ROOT_FROM = (6 / 29) ** 3
_25_TO_7 = 25.0**7
# Half a turn in degrees, and what rounding adds to the difference of hues that are exactly opposite.
_OPPOSITE = 180 + 1e-9
# Section III-C of [4]: a Gaussian window of 11 x 11 with a deviation of 1.5, K1 and K2; full scale is 1.
_RADIUS, _DEVIATION = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2


_FIGURES = {"min_psnr": "psnr", "min_ssim": "ssim", "max_delta_e": "delta_e", "max_seam_jump": "seam_jump"}
_WITHIN = {"max_delta_e": "mean", "max_seam_jump": "change"}
_WITHOUT = {
    "min_ssim": "cannot be tested without a picture in which a window of 11 x 11 pixels counts",
    "max_delta_e": "cannot be tested where the numbers are not grey, or red, green and blue, in sRGB or linear light",
    "max_seam_jump": "cannot be tested where no chart has three texels in a row on either side of a seam",
}
_REMEDY = "leave that limit out, or choose what has it with --on, --slots, --texture, --channels or --space"


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
    # (K,) in both: how far colours jump where the surface goes on in another chart, mean over channels.
    jumps: tuple[Float64s, Float64s] | None = None
    size: tuple[int, int] | None = None  # rows and columns of an image or texture
    # Whether both files have the same colours here while another part is measured; textures then hold no colours.
    is_identical: bool = False
    # (K, N) in both: colours of texels that no face covers, but that faces look up; None: not a texture.
    around: tuple[Float32s, Float32s] | None = None
    other_opacity: bool = False  # whether opacity differs, which is not measured

    def squares(self) -> Float64s:
        """Return the squared error of each sample, mean over its channels, shape (S,)."""
        return np.asarray(np.square(self.test.astype(np.float64) - self.reference).mean(axis=1), np.float64)

    def described(self) -> dict[str, object]:
        return {"name": self.name, "kind": self.kind, "identical": self.is_identical, **figures([self])}

    def worst(self) -> dict[str, object]:
        """Return where the largest error in any channel is, and what it is, in JSON types; empty without samples."""
        errors = np.abs(self.test - self.reference).max(axis=1)
        if not errors.size:
            return {}
        at = int(errors.argmax())
        names = ("vertex",) if self.index.ndim == 1 else ("x", "y")
        return {
            "part": self.name,
            **dict(zip(names, np.atleast_1d(self.index[at]).tolist(), strict=True)),
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
        "delta_e": _delta_e([(part.delta_e, part.weights) for part in parts if part.delta_e is not None]),
        "worst": max(worst, key=lambda found: float(str(found["error"])), default=None),
        "near_seams": _near_seams(parts),
        "seam_jump": _jumps([part.jumps for part in parts if part.jumps is not None]),
        "around_charts": _around([part.around for part in parts if part.around is not None]),
    }


def _around(pairs: Sequence[tuple[Float32s, Float32s]]) -> dict[str, object] | None:
    """Return the error of texels that faces look up without covering them; None if there are no such texels."""
    errors = [np.abs(test.astype(np.float64) - reference) for reference, test in pairs if len(reference)]
    if not errors:
        return None
    squares = np.concatenate([np.square(each).mean(axis=1) for each in errors])
    worst = max(float(each.max()) for each in errors)
    return {"samples": len(squares), "psnr": psnr(squares, np.ones(len(squares))), "worst": worst}


def psnr(squares: Float64s, weights: Float64s) -> float | None:
    """Return the peak signal-to-noise ratio in dB for a full scale of 1; None if nothing differs."""
    total = float(weights.sum())
    mean = float(weights @ squares) / total if total > 0 else 0.0
    return -10 * math.log10(mean) if mean > 0 else None


def _delta_e(looks: Sequence[tuple[Float64s, Float64s]]) -> dict[str, float] | None:
    every, weights = (np.concatenate([np.zeros(0), *(pair[k] for pair in looks)]) for k in (0, 1))
    if not weights.sum() > 0:
        return None
    order = np.argsort(every)
    share = np.cumsum(weights[order]) / weights.sum()
    at = min(int(np.searchsorted(share, 0.95)), len(every) - 1)
    mean = float(weights @ every / weights.sum())
    return {"mean": mean, "p95": float(every[order][at]), "worst": float(every.max())}


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


def _jumps(jumps: Sequence[tuple[Float64s, Float64s]]) -> dict[str, object] | None:
    reference, test = (np.concatenate([np.zeros(0), *(pair[k] for pair in jumps)]) for k in (0, 1))
    if not reference.size:
        return None
    means = {"reference": float(reference.mean()), "test": float(test.mean())}
    return {"steps": len(reference), **means, "change": float((test - reference).mean())}


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
    # A limit that cannot be measured raises InputError: an unchecked limit must not pass.
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
            sign = 1 if limit.startswith("min") else -1
            kept = measured is None or sign * measured >= sign * allowed
            verdicts.append(Verdict(limit, part["name"], allowed, measured, kept))
    seamless = limits.max_seam_jump is not None and all(part["near_seams"] is None for part in held)
    return verdicts, ["--max-seam-jump is kept, because there is no seam"] if seamless else []


def check_moves(moves: Moves, limits: Limits) -> list[Verdict]:
    """Hold the geometry to its limit; where there is none, but others, to what rounding explains."""
    if all(allowed is None for allowed in vars(limits).values()):
        return []
    allowed = ROUNDED_MOVE if limits.max_move is None else limits.max_move
    return [Verdict("max_move", "geometry", allowed, moves.largest, moves.largest <= allowed)]


def cie_lab(linear: NDArray[np.floating]) -> Float64s:
    """Convert linear sRGB to CIE L*a*b* under D65."""
    xyz = np.maximum(linear, 0).astype(np.float64) @ (_XYZ / _XYZ.sum(axis=1, keepdims=True)).T
    f = np.where(xyz > _CUBE_ROOT_FROM, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def delta_e_2000(one: Float64s, other: Float64s) -> Float64s:
    """Compute the CIEDE2000 difference of pairs of colours [1]_, with k_L = k_C = k_H = 1."""
    (l1, c1, h1), (l2, c2, h2) = _with_hue(one, other)
    dl, dc = l2 - l1, c2 - c1  # eqs. (8), (9)
    turn = np.where(np.abs(h2 - h1) <= _OPPOSITE, h2 - h1, h2 - h1 - 360 * np.sign(h2 - h1))
    turn = np.where(c1 * c2 == 0, 0.0, turn)  # eq. (10)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)  # eq. (11)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2  # eqs. (12), (13)
    hue = np.where(c1 * c2 == 0, h1 + h2, _mean_hue(h1, h2))
    t = (
        1
        - 0.17 * np.cos(np.radians(hue - 30))
        + 0.24 * np.cos(np.radians(2 * hue))
        + 0.32 * np.cos(np.radians(3 * hue + 6))
        - 0.20 * np.cos(np.radians(4 * hue - 63))
    )  # eq. (15)
    off = (lightness - 50) ** 2
    s_l = 1 + 0.015 * off / np.sqrt(20 + off)  # eqs. (18) to (20)
    s_c, s_h = 1 + 0.045 * chroma, 1 + 0.015 * chroma * t
    rotation = 60 * np.exp(-(((hue - 275) / 25) ** 2))  # twice eq. (16)
    r_t = -np.sin(np.radians(rotation)) * 2 * np.sqrt(chroma**7 / (chroma**7 + _25_TO_7))  # eqs. (17), (21)
    parts = dl / s_l, dc / s_c, dh / s_h
    squares = parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2 + r_t * parts[1] * parts[2]
    return np.asarray(np.sqrt(np.maximum(squares, 0)), np.float64)  # eq. (22)


def _with_hue(*colours: Float64s) -> list[tuple[Float64s, ...]]:
    """Return lightness, chroma and hue in degrees of both colours, with a* stretched where chroma is small."""
    mean = sum(np.hypot(lab[:, 1], lab[:, 2]) for lab in colours) / 2  # eqs. (2), (3)
    stretch = 1 + 0.5 * (1 - np.sqrt(mean**7 / (mean**7 + _25_TO_7)))  # eqs. (4), (5)
    found: list[tuple[Float64s, ...]] = []
    # Side by side: how NumPy 2.0 rounds arctan2 of other arrays depends on where in memory they lie.
    for lightness, a, b in (np.ascontiguousarray(lab.T) for lab in colours):
        stretched = stretch * a
        hue = np.degrees(np.arctan2(b, stretched)) % 360  # eqs. (6), (7)
        found.append((lightness, np.hypot(stretched, b), hue))
    return found


def _mean_hue(h1: Float64s, h2: Float64s) -> Float64s:
    """Return the mean of two hues on the shorter way around, eq. (14)."""
    total = h1 + h2
    around = np.where(total < 360, total + 360, total - 360)
    return np.asarray(np.where(np.abs(h1 - h2) <= _OPPOSITE, total, around) / 2, np.float64)


def structural_similarity(reference: Float32s, test: Float32s, counts: Bools) -> float | None:
    """Compute the mean SSIM, eqs. (13) and (17) of [4], over all windows that hold only pixels that count."""
    from scipy.ndimage import minimum_filter

    whole = minimum_filter(counts, 2 * _RADIUS + 1, mode="constant", cval=False)
    if not whole.any():
        return None
    channels = zip(np.moveaxis(reference, 2, 0), np.moveaxis(test, 2, 0), strict=True)
    return float(np.mean([_of_channel(one, other)[whole].mean() for one, other in channels]))


def _of_channel(one: Float32s, other: Float32s) -> Float64s:
    x, y = one.astype(np.float64), other.astype(np.float64)
    mean_x, mean_y = _windowed(x), _windowed(y)
    variances = _windowed(x * x) - mean_x**2 + _windowed(y * y) - mean_y**2
    covariance = _windowed(x * y) - mean_x * mean_y
    similarity = (2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)
    return np.asarray(similarity / ((mean_x**2 + mean_y**2 + _C1) * (variances + _C2)), np.float64)


def _windowed(values: Float64s) -> Float64s:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(values, _DEVIATION, radius=_RADIUS), np.float64)
