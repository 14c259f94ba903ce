"""Losses of the network that reads noise, and their gradients."""

from __future__ import annotations

import numpy as np

from beltrami_cli.flow.noise.candidates import mixed, split_mixture
from beltrami_cli.flow.noise.network import QUANTILES, TOTAL_QUANTILES

# Weights of the heads in the loss.
COUNTED = {"total": 3.0, "deviations": 2.0, "correlations": 2.0, "places": 0.5}


def losses(
    all_outputs: dict[str, np.ndarray],
    truths: dict[str, np.ndarray],
    candidates: dict[str, np.ndarray],
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the loss of each head, and the gradient of its outputs; truths that are unknown are NaN."""
    values, gradients = {}, {}
    for name, given in all_outputs.items():
        outputs = given.reshape(*truths[name].shape, -1)
        if name == "correlations":
            values[name], gradient = _squared_error(outputs, truths[name])
        else:
            shares = np.array(TOTAL_QUANTILES if name == "total" else QUANTILES, np.float32)
            values[name], gradient = _pinball(outputs, truths[name], candidates[name], shares)
        gradients[name] = (COUNTED[name] * gradient).reshape(given.shape).astype(np.float32)
    return values, gradients


def _squared_error(outputs: np.ndarray, truth: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the mean squared error of correlations, of which outputs are the inverse hyperbolic tangents."""
    known = np.isfinite(truth)
    count, read_as = max(1, known.sum()), np.tanh(outputs)
    error = np.where(known[..., None], np.nan_to_num(truth)[..., None] - read_as, 0)
    return float(np.square(error).sum() / count), -2 * error * (1 - read_as**2) / count


def _pinball(
    outputs: np.ndarray, truth: np.ndarray, candidates: np.ndarray, shares: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the mean pinball loss of quantiles at some shares."""
    known, read_as = np.isfinite(truth), mixed(outputs, candidates)
    count = max(1, known.sum()) * len(shares)
    error = np.nan_to_num(truth)[..., None] - read_as
    slope = np.where(error > 0, shares, shares - 1) * known[..., None]
    gradient = _through_mixture(-slope / count, read_as, outputs, candidates)
    return float((slope * error).sum() / count), gradient


def _through_mixture(
    gradient: np.ndarray, read_as: np.ndarray, outputs: np.ndarray, candidates: np.ndarray
) -> np.ndarray:
    """Return the gradient of the outputs from that of the readings, in which they are combined with candidates."""
    readings, weights = split_mixture(outputs, candidates)
    toward = [
        (gradient * (part[..., None] - read_as)).sum(axis=-1) for part in np.moveaxis(candidates, -1, 0)
    ]
    toward.append((gradient * (readings - read_as)).sum(axis=-1))
    return np.concatenate([gradient * weights[..., -1:], weights * np.stack(toward, axis=-1)], axis=-1)
