"""Losses of the network of squares, and their gradients."""

from __future__ import annotations

import numpy as np

from beltrami_cli.flow.noise.network import QUANTILES, TOTAL_QUANTILES, mixed, split_mixture

# Weights of the heads in the loss.
COUNTED = {"total": 3.0, "deviations": 2.0, "correlations": 2.0, "places": 0.5}


def losses(
    all_outputs: dict[str, np.ndarray],
    truths: dict[str, np.ndarray],
    candidates: dict[str, np.ndarray],
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the loss of each head and its gradient: pinball losses of quantiles, squared errors of correlations."""
    values, gradients = {}, {}
    for name, given in all_outputs.items():
        truth, known = truths[name], np.isfinite(truths[name])
        count, outputs = max(1, known.sum()), given.reshape(*truth.shape, -1)
        if name == "correlations":
            read_as = np.tanh(outputs)
            error = np.where(known[..., None], np.nan_to_num(truth)[..., None] - read_as, 0)
            slope, parts = 2 * error * (1 - read_as**2), 1
            values[name] = float(np.square(error).sum() / count)
        else:
            read_as = mixed(outputs, candidates[name]) if name in candidates else outputs
            error = np.nan_to_num(truth)[..., None] - read_as
            shares = np.array(TOTAL_QUANTILES if name == "total" else QUANTILES, np.float32)
            slope, parts = np.where(error > 0, shares, shares - 1) * known[..., None], len(shares)
            values[name] = float((slope * error).sum() / count / parts)
        gradient = -COUNTED[name] * slope / count / parts
        if name in candidates:
            gradient = _through_mixture(gradient, read_as, outputs, candidates[name])
        gradients[name] = gradient.reshape(given.shape).astype(np.float32)
    return values, gradients


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
