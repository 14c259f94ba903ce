"""Figures of the differences of colours, such as CIEDE2000 and structural similarity, and limits on them.

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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import Space
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Indices, within
from beltrami_cli.surface.colour_values import srgb_to_linear

Pair = tuple[Float32s, Float32s]  # the same samples, or means of them, in reference and test

# Linear sRGB -> XYZ [2]; rows add up to the white point.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_CUBE_ROOT_FROM = (6 / 29) ** 3
_25_TO_7 = 25.0**7
# Half a turn in degrees, and what rounding adds to the difference of hues that are exactly opposite.
_HALF_TURN = 180 + 1e-9
# Section III-C of [4]: a Gaussian window of 11 x 11 with a deviation of 1.5, K1 and K2; full scale is 1.
_RADIUS, _DEVIATION = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2
# Samples, and the side of a square of windows, that are worked on at a time: three channels in double precision stay in
# the processor's cache, and below 256 KB, from which on NumPy searches the call stack before each sum.
_BLOCK = 1 << 13
_SQUARE = 88
_SAMPLES_SHARE = 0.7  # of the time of a picture: 4.6 s of 16.7 million samples, and 2.1 s of their windows

_FIGURES = {"min_psnr": "psnr", "min_ssim": "ssim", "max_delta_e": "delta_e", "max_seam_jump": "seam_jump"}
_LIMITED_FIGURE = {"max_delta_e": "mean", "max_seam_jump": "change"}
_MISSING_FIGURE = {
    "min_ssim": "cannot be tested without a picture in which a window of 11 x 11 pixels counts",
    "max_delta_e": "cannot be tested where the numbers are not grey, or red, green and blue, in sRGB or linear light",
    "max_seam_jump": "cannot be tested where no chart has three texels in a row on either side of a seam",
}
_REMEDY = "leave that limit out, or choose what has it with --on, --slots, --texture, --channels or --space"


@dataclass(frozen=True, kw_only=True)
class ComparedColours:
    """A texture, an image, or the vertices of a mesh, in two files; its colours are read block by block."""

    name: str
    kind: Literal["vertices", "texture", "image"]
    index: Indices  # (S,): the compared vertices, or pixels as row * width + column
    read: Callable[[Indices], Pair]  # colours of vertices or pixels, (K, N), full scale 1
    space: Space  # of these
    weights: Float64s | None = None  # (S,): what each sample counts; None: all the same
    # (S,): within 4 texels of a seam, or at a place where the file splits vertices; None: no seams.
    near_seams: Bools | None = None
    # (K,) in both: how far colours jump where the surface goes on in another chart, mean over channels.
    jumps: tuple[Float64s, Float64s] | None = None
    size: tuple[int, int] | None = None  # rows and columns of an image or texture
    is_identical: bool = False  # the same colours in both files, so that only other parts are measured
    # (K, N): colours of texels that no face covers, but that faces look up; None: not a texture.
    around: Pair | None = None
    other_opacity: bool = False  # whether opacity differs, which is not measured

    def blocks(self) -> Iterator[tuple[slice, Float32s, Float32s]]:
        for block in large_arrays.blocks(len(self.index), _BLOCK):
            yield block, *self.read(self.index[block])

    def covered(self) -> Bools:
        """Return which pixels of an image or texture are compared, (H, W)."""
        assert self.size is not None
        covered = np.zeros(self.size, bool)
        covered.reshape(-1)[self.index] = True
        return covered

    def read_rows(self, rows: slice) -> Pair:
        """Return rows of pixels of an image or texture, (R, W, N)."""
        assert self.size is not None
        width = self.size[1]
        one, other = self.read(np.arange(rows.start * width, rows.stop * width))
        return one.reshape(-1, width, one.shape[1]), other.reshape(-1, width, other.shape[1])


@dataclass(frozen=True)
class Measured:
    """The differences of the samples of one part; `figures` combines several."""

    part: ComparedColours
    errors: Float32s  # (S,): the largest in any channel
    rms: Float32s  # (S,): root mean squares over the channels; squares could vanish in single precision
    delta_e: Float32s  # (S,): CIEDE2000 differences; NaN where the numbers are not colours
    ssim: float | None
    change: float  # mean absolute change of the channels

    def described(self) -> dict[str, object]:
        part = self.part
        return {"name": part.name, "kind": part.kind, "identical": part.is_identical, **figures([self])}

    def worst(self) -> dict[str, Any]:
        """Return the sample with the largest error in any channel; there must be one."""
        part, at = self.part, int(self.errors.argmax())
        index, delta_e = int(part.index[at]), float(self.delta_e[at])
        (reference,), (test,) = part.read(part.index[at : at + 1])
        row, column = divmod(index, part.size[1]) if part.size else (0, 0)
        return {
            "part": part.name, **({"x": column, "y": row} if part.size else {"vertex": index}),
            "error": float(self.errors[at]), "delta_e": None if math.isnan(delta_e) else delta_e,
            "reference": reference.tolist(), "test": test.tolist(),
        }  # fmt: skip


def measure(part: ComparedColours, tick: Callable[[float], None] = lambda share: None) -> Measured:
    """Go through the samples of a part, and the windows of a picture; `tick` is called with the share that is done."""
    first, samples = 1.0 if part.size is None else _SAMPLES_SHARE, len(part.index)
    errors, rms, delta_e = (large_arrays.empty(samples, np.float32) for _ in range(3))
    total = 0.0
    for block, reference, test in part.blocks():
        tick(first * block.start / samples)
        changes = np.abs(test - reference)
        errors[block] = changes.max(axis=1)
        total += float(changes.mean(axis=1, dtype=np.float64).sum())
        rms[block] = np.sqrt(np.square(test.astype(np.float64) - reference).mean(axis=1))
        delta_e[block] = colour_differences(reference, test, part.space)
    similarity = None
    if part.size is not None:
        similarity = structural_similarity(
            part.read_rows, part.covered(), lambda share: tick(first + (1 - first) * share)
        )
    return Measured(part, errors, rms, delta_e, similarity, total / max(1, samples))


def figures(measured: Sequence[Measured]) -> dict[str, Any]:
    """Compute the figures of one or several parts taken together, in JSON types; None where there are none."""
    parts = [each.part for each in measured]
    rms = _joined([each.rms for each in measured])
    delta_e = _joined([each.delta_e for each in measured])
    is_weighted = any(part.weights is not None for part in parts)
    weights = _joined([_weights(part) for part in parts]) if is_weighted else None
    near = (
        _joined([_whole(part, False) if part.near_seams is None else part.near_seams for part in parts]) > 0
    )
    structured = [(each.ssim, _weights(each.part).sum()) for each in measured if each.ssim is not None]
    worst = [each.worst() for each in measured if len(each.errors)]
    weights_near = None if weights is None else weights[near]
    return {
        "samples": len(rms),
        "psnr": _psnr(rms, weights),
        "ssim": _mean(*np.array(structured).T) if structured else None,
        "delta_e": _spread(delta_e, weights),
        "worst": max(worst, key=lambda found: float(found["error"]), default=None),
        "near_seams": {
            "samples": int(near.sum()), "psnr": _psnr(rms[near], weights_near),
            "delta_e": _mean(delta_e[near], weights_near),
        } if near.any() else None,
        "seam_jump": _jumps([part.jumps for part in parts if part.jumps is not None]),
        "around_charts": _around([part.around for part in parts if part.around is not None]),
    }  # fmt: skip


def _joined(arrays: Sequence[Array]) -> Array:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays or [np.zeros(0)])


def _whole(part: ComparedColours, value: float) -> Array:
    return np.broadcast_to(value, len(part.index))


def _weights(part: ComparedColours) -> Float64s:
    return _whole(part, 1.0) if part.weights is None else part.weights


def _known(values: Array, weights: Float64s | None) -> tuple[Array, Float64s | None]:
    known = ~np.isnan(values)
    return (values, weights) if known.all() else (values[known], None if weights is None else weights[known])


def _mean(values: Array, weights: Float64s | None, power: int = 1) -> float | None:
    """Return the mean of a power of the known values; None without any."""
    values, weights = _known(values, weights)
    total = len(values) if weights is None else weights.sum()
    factors = [values] * power + ([] if weights is None else [weights])
    # einsum makes no array of the products.
    products = np.einsum(",".join("i" * len(factors)) + "->", *factors, dtype=np.float64)
    return float(products / total) if total else None


def _psnr(rms: Array, weights: Float64s | None) -> float | None:
    """Return the peak signal-to-noise ratio in dB for a full scale of 1; None if nothing differs."""
    mean = _mean(rms, weights, power=2)
    return -10 * math.log10(mean) if mean else None


def _spread(delta_e: Array, weights: Float64s | None) -> dict[str, float] | None:
    """Return mean, weighted 95th percentile, and maximum of the Delta E of all samples."""
    mean, (values, weights) = _mean(delta_e, weights), _known(delta_e, weights)
    if mean is None:
        return None
    p95 = np.quantile(values, 0.95, weights=weights, method="inverted_cdf")
    return {"mean": mean, "p95": float(p95), "worst": float(values.max())}


def _around(pairs: Sequence[Pair]) -> dict[str, object] | None:
    """Return the error of texels that faces look up without covering them; None if there are no such texels."""
    errors = [np.abs(test.astype(np.float64) - reference) for reference, test in pairs if len(reference)]
    if not errors:
        return None
    rms = np.concatenate([np.sqrt(np.square(each).mean(axis=1)) for each in errors])
    worst = max(float(each.max()) for each in errors)
    return {"samples": len(rms), "psnr": _psnr(rms, None), "worst": worst}


def _jumps(jumps: Sequence[tuple[Float64s, Float64s]]) -> dict[str, object] | None:
    reference, test = (_joined([pair[k] for pair in jumps]) for k in (0, 1))
    if not reference.size:
        return None
    means = {"reference": float(reference.mean()), "test": float(test.mean())}
    return {"steps": len(reference), **means, "change": float((test - reference).mean())}


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
    for limit, allowed in vars(limits).items():
        if allowed is None or limit not in _FIGURES:
            continue
        for part in compared:
            if limit == "max_seam_jump" and part["near_seams"] is None:
                continue  # nothing can jump
            figure = part[_FIGURES[limit]]
            if figure is None and limit != "min_psnr":
                option = f"--{limit.replace('_', '-')}"
                raise InputError(test, f"{part['name']}: {option} {_MISSING_FIGURE[limit]}", _REMEDY)
            measured = float(figure[_LIMITED_FIGURE[limit]]) if limit in _LIMITED_FIGURE else figure
            sign = 1 if limit.startswith("min") else -1
            kept = measured is None or sign * measured >= sign * allowed
            verdicts.append(Verdict(limit, part["name"], allowed, measured, kept))
    seamless = limits.max_seam_jump is not None and all(part["near_seams"] is None for part in compared)
    return verdicts, ["--max-seam-jump is kept, because there is no seam"] if seamless else []


def cie_lab(linear: NDArray[np.floating]) -> Float64s:
    """Convert linear sRGB to CIE L*a*b* under D65."""
    xyz = np.maximum(linear, 0).astype(np.float64) @ (_XYZ / _XYZ.sum(axis=1, keepdims=True)).T
    f = np.where(xyz > _CUBE_ROOT_FROM, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def delta_e_2000(one: Float64s, other: Float64s) -> Float64s:
    """Compute the CIEDE2000 difference of pairs of colours [1]_, with k_L = k_C = k_H = 1."""
    (l1, c1, h1), (l2, c2, h2) = _with_hue(one, other)
    dl, dc, is_grey = l2 - l1, c2 - c1, c1 * c2 == 0  # eqs. (8), (9)
    turn = h2 - h1
    turn = np.where(np.abs(turn) <= _HALF_TURN, turn, turn - 360 * np.sign(turn))
    turn = np.where(is_grey, 0.0, turn)  # eq. (10)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)  # eq. (11)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2  # eqs. (12), (13)
    hue = np.where(is_grey, h1 + h2, (h1 + turn / 2) % 360)  # eq. (14)
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
    r_t = -np.sin(np.radians(rotation)) * 2 * _near_grey(chroma)  # eqs. (17), (21)
    parts = dl / s_l, dc / s_c, dh / s_h
    squares = parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2 + r_t * parts[1] * parts[2]
    return np.asarray(np.sqrt(np.maximum(squares, 0)), np.float64)  # eq. (22)


def _with_hue(*colours: Float64s) -> list[tuple[Float64s, ...]]:
    """Return lightness, chroma and hue in degrees of both colours, with a* stretched where chroma is small."""
    mean = np.mean([_length(lab[:, 1], lab[:, 2]) for lab in colours], axis=0)  # eqs. (2), (3)
    stretch = 1 + 0.5 * (1 - _near_grey(mean))  # eqs. (4), (5)
    found: list[tuple[Float64s, ...]] = []
    # Side by side: how NumPy 2.0 rounds arctan2 of other arrays depends on where in memory they lie.
    for lightness, a, b in (np.ascontiguousarray(lab.T) for lab in colours):
        stretched = stretch * a
        angle = np.degrees(np.arctan2(b, stretched))  # eqs. (6), (7)
        found.append((lightness, _length(stretched, b), np.where(angle < 0, angle + 360, angle)))
    return found


def _length(a: Float64s, b: Float64s) -> Float64s:
    return np.asarray(np.sqrt(a * a + b * b))  # nothing overflows, and hypot takes five times as long


def _near_grey(chroma: Float64s) -> Float64s:
    """Return sqrt(C^7 / (C^7 + 25^7))."""
    square = chroma * chroma
    seventh = square * square * square * chroma
    return np.asarray(np.sqrt(seventh / (seventh + _25_TO_7)))


def colour_differences(reference: Float32s, test: Float32s, space: Space) -> Float64s:
    """Compute how different colours look, shape (S,); NaN if they are not colours."""
    if space not in ("srgb", "linear") or reference.shape[1] not in (1, 3):
        return np.full(len(reference), np.nan)
    light = (srgb_to_linear(each) if space == "srgb" else each for each in (reference, test))
    return delta_e_2000(*(cie_lab(np.broadcast_to(each, (len(each), 3))) for each in light))


def structural_similarity(
    read: Callable[[slice], Pair], counts: Bools, tick: Callable[[float], None] = lambda share: None
) -> float | None:
    """Compute the mean SSIM, eqs. (13) and (17) of [4], over all windows that hold only pixels that count.

    `read` gives rows of both images, shape (R, W, N).
    """
    inside = slice(_RADIUS, -_RADIUS)
    whole = ~within(~counts, _RADIUS)[inside, inside]
    total, windows = 0.0, 0
    for rows in large_arrays.blocks(len(whole), _SQUARE):
        tick(rows.start / len(whole))
        columns = [
            block for block in large_arrays.blocks(whole.shape[1], _SQUARE) if whole[rows, block].any()
        ]
        if not columns:
            continue
        pair = [
            np.moveaxis(image, 2, 0).astype(np.float64)
            for image in read(slice(rows.start, rows.stop + 2 * _RADIUS))
        ]
        for block in columns:
            around = slice(block.start, block.stop + 2 * _RADIUS)
            similarity = _similarity(*(image[:, :, around] for image in pair))[:, whole[rows, block]]
            total, windows = total + float(similarity.sum()), windows + similarity.size
    return total / windows if windows else None


def _similarity(x: Float64s, y: Float64s) -> Float64s:
    mean_x, mean_y = _windowed(x), _windowed(y)
    squares, product = mean_x * mean_x + mean_y * mean_y, 2 * mean_x * mean_y
    variances, covariance = _windowed(x * x + y * y) - squares, 2 * _windowed(x * y) - product
    return (product + _C1) * (covariance + _C2) / ((squares + _C1) * (variances + _C2))


def _windowed(values: Float64s) -> Float64s:
    """Return the weighted means over the windows that lie within images, shape (N, R, W)."""
    from scipy.ndimage import gaussian_filter

    means = gaussian_filter(values, _DEVIATION, radius=_RADIUS, axes=(1, 2))
    return means[:, _RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
