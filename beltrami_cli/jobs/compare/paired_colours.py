"""The colours of two files at the same samples, and the figures that tell how they differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from beltrami_cli.jobs.compare.colour_difference import cie_lab, delta_e_2000
from beltrami_cli.surface.colour_values import srgb_to_linear

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import Space

_BLOCK = 1 << 18  # colours compared at a time, which bounds the memory for them


@dataclass(frozen=True)
class SeamSteps:
    """How far colours jump where the surface goes on in another chart, at K places.

    Attributes
    ----------
    reference, test : ndarray of float64, shape (K,)
        The difference of the colours that both sides have at the seam, mean over the channels, full scale 1.
    """

    reference: NDArray[np.float64]
    test: NDArray[np.float64]


@dataclass(frozen=True)
class PairedColours:
    """A texture, an image, or the vertices of a mesh, in two files.

    Attributes
    ----------
    name : str
        What it is, for people.
    kind : {"vertices", "texture", "image"}
        What its samples are.
    reference, test : ndarray of float32, shape (S, N)
        Their colours, full scale 1.
    place : ndarray of int64, shape (S,) or (S, 2)
        The vertex, or column and row.
    weights : ndarray of float64, shape (S,)
        What each counts.
    delta_e : ndarray of float64, shape (S,), or None
        CIEDE2000 differences, where the numbers are colours.
    ssim : float or None
        Structural similarity, of images and textures.
    near_seams : ndarray of bool, shape (S,), or None
        Which samples are within 4 texels of a seam, or at a place where the file splits vertices; None: no seams.
    steps : SeamSteps or None
        Over the seams.
    """

    name: str
    kind: Literal["vertices", "texture", "image"]
    reference: NDArray[np.float32]
    test: NDArray[np.float32]
    place: NDArray[np.int64]
    weights: NDArray[np.float64]
    delta_e: NDArray[np.float64] | None
    ssim: float | None = None
    near_seams: NDArray[np.bool_] | None = None
    steps: SeamSteps | None = None

    def squares(self) -> NDArray[np.float64]:
        """Return the squared error of each sample, mean over its channels, shape (S,)."""
        return np.asarray(np.square(self.test.astype(np.float64) - self.reference).mean(axis=1), np.float64)

    def worst(self) -> dict[str, object]:
        """Return where the largest error in any channel is, and what it is, in JSON types; empty without samples."""
        errors = np.abs(self.test - self.reference).max(axis=1)
        if not errors.size:
            return {}
        at = int(errors.argmax())
        place: dict[str, object] = {"part": self.name}
        names = ("vertex",) if self.place.ndim == 1 else ("x", "y")
        place |= dict(zip(names, np.atleast_1d(self.place[at]).tolist(), strict=True))
        return {
            **place,
            "error": float(errors[at]),
            "delta_e": None if self.delta_e is None else float(self.delta_e[at]),
            "reference": self.reference[at].tolist(),
            "test": self.test[at].tolist(),
        }


def differences(
    reference: NDArray[np.float32], test: NDArray[np.float32], space: Space
) -> NDArray[np.float64] | None:
    """Compute how different colours look, shape (S,); None if they are no colours.

    Parameters
    ----------
    reference, test : ndarray of float32, shape (S, N)
        Grey, or red, green and blue, full scale 1.
    space : {"srgb", "linear", "oklab", "data"}
        What they are in.
    """
    if space not in ("srgb", "linear") or reference.shape[1] not in (1, 3):
        return None
    found = np.empty(len(reference))
    for first in range(0, len(reference), _BLOCK):
        block = slice(first, first + _BLOCK)
        found[block] = delta_e_2000(*(_lab(colours[block], space) for colours in (reference, test)))
    return found


def _lab(colours: NDArray[np.float32], space: Space) -> NDArray[np.float64]:
    linear = srgb_to_linear(colours) if space == "srgb" else colours
    return cie_lab(np.broadcast_to(linear, (len(linear), 3)))


def figures(pairs: Sequence[PairedColours]) -> dict[str, object]:
    """Compute the figures of one or several parts taken together, in JSON types.

    Returns
    -------
    dict
        "samples"; "psnr" in dB, 10 log10(1 / mean squared error) over samples and channels, None where nothing
        differs; "ssim"; "delta_e" with "mean", "p95" and "worst"; "worst", the sample with the largest error;
        "near_seams" with "samples", "psnr" and "delta_e"; "seam_jump" with "steps", "reference", "test", and "change",
        the mean of test minus reference. None where something cannot be told.
    """
    weights = np.concatenate([pair.weights for pair in pairs])
    squares = np.concatenate([pair.squares() for pair in pairs])
    coloured = [pair for pair in pairs if pair.delta_e is not None]
    delta_e = _delta_e(coloured)
    near = [pair for pair in pairs if pair.near_seams is not None]
    structured = [(pair.ssim, float(pair.weights.sum())) for pair in pairs if pair.ssim is not None]
    total = sum(weight for _, weight in structured)
    worst = [found for found in (pair.worst() for pair in pairs) if found]
    return {
        "samples": len(weights),
        "psnr": psnr(squares, weights),
        "ssim": sum(value * weight for value, weight in structured) / total if total else None,
        "delta_e": delta_e,
        "worst": max(worst, key=lambda found: float(str(found["error"])), default=None),
        "near_seams": _near_seams(near),
        "seam_jump": _jump([pair.steps for pair in pairs if pair.steps is not None]),
    }


def psnr(squares: NDArray[np.float64], weights: NDArray[np.float64]) -> float | None:
    """Return the peak signal-to-noise ratio in dB for a full scale of 1; None if nothing differs."""
    total = float(weights.sum())
    mean = float(weights @ squares) / total if total > 0 else 0.0
    return -10 * math.log10(mean) if mean > 0 else None


def _delta_e(pairs: Sequence[PairedColours]) -> dict[str, float] | None:
    values = [pair.delta_e for pair in pairs if pair.delta_e is not None]
    weights = np.concatenate([pair.weights for pair in pairs]) if values else np.zeros(0)
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


def _near_seams(pairs: Sequence[PairedColours]) -> dict[str, object] | None:
    chosen = [(pair, pair.near_seams) for pair in pairs if pair.near_seams is not None]
    count = sum(int(np.count_nonzero(near)) for _, near in chosen)
    if not count:
        return None
    weights = np.concatenate([pair.weights[near] for pair, near in chosen])
    squares = np.concatenate([pair.squares()[near] for pair, near in chosen])
    looks = [(pair.delta_e[near], pair.weights[near]) for pair, near in chosen if pair.delta_e is not None]
    mean = None
    if looks and sum(weight.sum() for _, weight in looks) > 0:
        mean = float(
            sum(value @ weight for value, weight in looks) / sum(weight.sum() for _, weight in looks)
        )
    return {"samples": count, "psnr": psnr(squares, weights), "delta_e": mean}


def _jump(steps: Sequence[SeamSteps]) -> dict[str, object] | None:
    reference = np.concatenate([step.reference for step in steps]) if steps else np.zeros(0)
    if not reference.size:
        return None
    test = np.concatenate([step.test for step in steps])
    return {
        "steps": len(reference),
        "reference": float(reference.mean()),
        "test": float(test.mean()),
        "change": float((test - reference).mean()),
    }
