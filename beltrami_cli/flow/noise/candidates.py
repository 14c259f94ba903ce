"""Estimates of the noise that are candidates for the readings of the network, and their mixture.

A reading is a weighted mean of candidates and of the network's own reading. The network chooses the weights.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int64s
from beltrami_cli.flow.noise.components import FLOOR, SCALES, covariance_of_cells, log_reading
from beltrami_cli.flow.noise.even_cells import EVEN_SHARES, STATISTICS

# Number of candidates of each reading.
CANDIDATES = {"total": STATISTICS + 4, "deviations": STATISTICS + 6, "places": 2}

# The statistics of even cells that are usually the best: of the largest share, and the mean over neighbourhoods.
_USUAL = [len(EVEN_SHARES) - 1, len(EVEN_SHARES)]


def candidates_of(even: Float32s, quiet: Float32s, counts: Int64s) -> dict[str, Array]:
    """Return the candidates of N surfaces with `counts` neighbourhoods each, as `log_reading`, along the last axis.

    "total", shape (N, 1, M), and "deviations" by scale and component, shape (N, SCALES * 3, M), are made from the
    deviations in even cells, shape (N, SCALES, STATISTICS, 3); "places", shape (P, 1, M), from the deviations of quiet
    cells, shape (P, 3), relative to the mean of their surface.
    """
    places = log_reading(4.0**quiet - FLOOR).mean(axis=1)
    places -= np.repeat(np.add.reduceat(places, starts_of(counts)) / counts, counts)
    of_places = np.stack([places, np.zeros_like(places)], axis=-1)[:, None]
    return {**_candidates_of_even(even), "places": of_places}


def _candidates_of_even(even: Float32s) -> dict[str, Array]:
    """Return the candidates "total" and "deviations" from the deviations in even cells.

    The candidates of a scale and component are its deviations, those of the finest scale, and those of the differences
    of channels at its scale and at the finest. Differences of channels have the least texture, and independent noise
    has the same deviation in all of them.
    """
    variances = np.maximum(4.0**even - FLOOR, 0)
    usual = variances[:, :, _USUAL]
    of_differences = np.broadcast_to(usual[..., 1:].mean(axis=3, keepdims=True), usual.shape)
    finest, finest_of_differences = (
        np.broadcast_to(each[:, :1], usual.shape) for each in (usual, of_differences)
    )
    by_component = np.concatenate([variances, finest, of_differences, finest_of_differences], axis=2)
    of_all = covariance_of_cells(np.moveaxis(variances.mean(axis=3), 1, 0))
    total = np.concatenate([of_all, of_differences[:, 0, :, 0], of_differences[:, 1, :, 0]], axis=1)
    return {
        "total": log_reading(total[:, None]),
        "deviations": log_reading(np.moveaxis(by_component, 2, 3).reshape(len(even), SCALES * 3, -1)),
    }


def mixed(outputs: Array, candidates: Array) -> Array:
    """Combine M candidates and the network's own readings to Q readings, by weights that the network chooses.

    Outputs have the shape (..., Q + M + 1): the network's own readings, then logarithms of the weights, the last one
    for the own readings. Candidates have the shape (..., M).
    """
    readings, weights = split_mixture(outputs, candidates)
    mean: Array = (weights[..., :-1] * candidates).sum(axis=-1)[..., None] + weights[..., -1:] * readings
    return mean


def split_mixture(outputs: Array, candidates: Array) -> tuple[Array, Array]:
    """Return the network's own readings, shape (..., Q), and the weights, shape (..., M + 1)."""
    count = outputs.shape[-1] - candidates.shape[-1] - 1
    weights = np.exp(outputs[..., count:] - outputs[..., count:].max(axis=-1, keepdims=True))
    return outputs[..., :count], weights / weights.sum(axis=-1, keepdims=True)


def starts_of(counts: Int64s) -> Int64s:
    """Return the first row of each surface, given the numbers of their rows."""
    return np.append(0, np.cumsum(counts)[:-1])
