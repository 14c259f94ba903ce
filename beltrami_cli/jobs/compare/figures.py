"""Figures of the differences of two files: PSNR, Delta E, SSIM, steps at seams; None where there are none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, TypedDict

import numpy as np

from beltrami_cli.arrays import Array, Float64s
from beltrami_cli.jobs.compare.measured import Measured, Pair


class DeltaEFigures(TypedDict):
    """CIEDE2000 differences of all samples."""

    mean: float
    p95: float  # 95th percentile
    worst: float


class SeamFigures(TypedDict):
    """Samples near seams."""

    samples: int
    psnr: float | None
    delta_e: float | None


class JumpFigures(TypedDict):
    """Mean steps of the colours over seams in both files, and how much they grow from the reference to the test."""

    steps: int
    reference: float
    test: float
    change: float


class AroundFigures(TypedDict):
    """Texels that faces look up without covering them."""

    samples: int
    psnr: float | None
    worst: float


class Figures(TypedDict):
    """The figures of one part, or of several taken together, in JSON types."""

    samples: int
    psnr: float | None  # None: nothing differs
    ssim: float | None
    delta_e: DeltaEFigures | None
    worst: dict[str, Any] | None  # as `Measured.worst`
    near_seams: SeamFigures | None
    seam_jump: JumpFigures | None
    around_charts: AroundFigures | None


class PartFigures(Figures):
    """The figures of one part, and which one it is."""

    name: str
    kind: Literal["vertices", "texture", "image"]
    identical: bool


def figures_of(measured: Measured) -> PartFigures:
    part = measured.part
    return {"name": part.name, "kind": part.kind, "identical": part.is_identical, **figures([measured])}


def figures(measured: Sequence[Measured]) -> Figures:
    """Compute the figures of parts taken together."""
    parts = [each.part for each in measured]
    rms = _joined([each.rms for each in measured])
    delta_e = _joined([each.delta_e for each in measured])
    is_weighted = any(part.weights is not None for part in parts)
    weights = _joined([part.sample_weights() for part in parts]) if is_weighted else None
    near = np.concatenate([np.zeros(0, bool), *(part.seam_mask() for part in parts)])
    structured = [(each.ssim, each.part.sample_weights().sum()) for each in measured if each.ssim is not None]
    worst = [each.worst() for each in measured if len(each.errors)]
    return {
        "samples": len(rms),
        "psnr": _psnr(rms, weights),
        "ssim": _mean(*np.array(structured).T) if structured else None,
        "delta_e": _delta_e(delta_e, weights),
        "worst": max(worst, key=lambda each: float(each["error"]), default=None),
        "near_seams": _near_seams(rms[near], delta_e[near], None if weights is None else weights[near]),
        "seam_jump": _seam_jump([part.jumps for part in parts if part.jumps is not None]),
        "around_charts": _around_charts([part.around for part in parts if part.around is not None]),
    }  # fmt: skip


def _joined(arrays: Sequence[Array]) -> Array:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays or [np.zeros(0)])


def _without_nan(values: Array, weights: Float64s | None) -> tuple[Array, Float64s | None]:
    known = ~np.isnan(values)
    return (values, weights) if known.all() else (values[known], None if weights is None else weights[known])


def _mean(values: Array, weights: Float64s | None, power: int = 1) -> float | None:
    """Return the mean of a power of the known values; None without any."""
    values, weights = _without_nan(values, weights)
    total = len(values) if weights is None else weights.sum()
    factors = [values] * power + ([] if weights is None else [weights])
    # einsum makes no array of the products.
    products = np.einsum(",".join("i" * len(factors)) + "->", *factors, dtype=np.float64)
    return float(products / total) if total else None


def _psnr(rms: Array, weights: Float64s | None) -> float | None:
    """Return the peak signal-to-noise ratio in dB for a full scale of 1; None if nothing differs."""
    mean = _mean(rms, weights, power=2)
    return -10 * math.log10(mean) if mean else None


def _delta_e(delta_e: Array, weights: Float64s | None) -> DeltaEFigures | None:
    mean, (values, weights) = _mean(delta_e, weights), _without_nan(delta_e, weights)
    if mean is None:
        return None
    p95 = np.quantile(values, 0.95, weights=weights, method="inverted_cdf")
    return {"mean": mean, "p95": float(p95), "worst": float(values.max())}


def _near_seams(rms: Array, delta_e: Array, weights: Float64s | None) -> SeamFigures | None:
    if not len(rms):
        return None
    return {"samples": len(rms), "psnr": _psnr(rms, weights), "delta_e": _mean(delta_e, weights)}


def _around_charts(pairs: Sequence[Pair]) -> AroundFigures | None:
    errors = [np.abs(test.astype(np.float64) - reference) for reference, test in pairs if len(reference)]
    if not errors:
        return None
    rms = np.concatenate([np.sqrt(np.square(each).mean(axis=1)) for each in errors])
    worst = max(float(each.max()) for each in errors)
    return {"samples": len(rms), "psnr": _psnr(rms, None), "worst": worst}


def _seam_jump(jumps: Sequence[tuple[Float64s, Float64s]]) -> JumpFigures | None:
    reference, test = (_joined([pair[k] for pair in jumps]) for k in (0, 1))
    if not reference.size:
        return None
    return {
        "steps": len(reference),
        "reference": float(reference.mean()),
        "test": float(test.mean()),
        "change": float((test - reference).mean()),
    }
