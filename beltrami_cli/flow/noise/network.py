"""The network that reads noise from features, and its weights.

Neighbourhoods are called squares here, whatever their kind. Each square goes through two layers; the mean, maximum and
minimum of its outputs over all squares describe the surface, together with its most even cells. From this context the
network reads the noise of the surface and of each square, both as quantiles of the logarithm of the deviation. The
noise of the surface is a weighted mean of candidates, which are measured in its even cells, and of the network's own
reading. The network chooses the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.components import FLOOR, PAIRS, SCALES, covariance_of_cells
from beltrami_cli.flow.noise.even_cells import EVEN_SHARES
from beltrami_cli.flow.noise.features import Features
from beltrami_cli.flow.noise.neighbourhoods import ThreeChannels

# The network reads log2(deviation + OFFSET), in 8-bit steps. Rounding to 8 bits has a deviation of 0.29.
OFFSET = 0.3

# Quantiles of the noise of the surface, and of all other readings.
TOTAL_QUANTILES = (0.05, 0.3, 0.5, 0.95)
QUANTILES = (0.05, 0.5, 0.95)

# Number of units in each layer. Those for clusters are smaller, which keeps the files of weights small.
WIDTHS = {
    "grid": {"square 1": 112, "square 2": 56, "whole 1": 112, "whole 2": 64, "place 1": 32},
    "cluster": {"square 1": 88, "square 2": 44, "whole 1": 88, "whole 2": 56, "place 1": 24},
}
# Number of estimates that are combined: the candidates, and the network's own reading.
_MIXED = {"total": len(EVEN_SHARES) + 8, "deviations": len(EVEN_SHARES) + 10, "relative": 3}
OUTPUTS = {
    "total": len(TOTAL_QUANTILES) + _MIXED["total"],
    "deviations": SCALES * 3 * (len(QUANTILES) + _MIXED["deviations"]),
    "correlations": SCALES * 3,
    "place 2": len(QUANTILES) + _MIXED["relative"],
}

# Limit at which standardised features are clipped, in standard deviations.
MAX_STANDARDISED = 6.0


class Layers:
    """The operations of the network; training records them to compute gradients."""

    def __init__(self, weights: dict[str, Float32s]) -> None:
        self.weights = weights

    def dense(self, rows: Any, name: str, *, is_last: bool = False) -> Any:
        """Multiply rows by a matrix, add a bias, and clip at 0 except in the last layer."""
        result = self.product(rows, self.weights[f"{name}.matrix"]) + self.weights[f"{name}.bias"]
        return result if is_last else np.maximum(result, 0)

    def product(self, rows: Any, matrix: Float32s) -> Any:
        """Multiply rows by a matrix.

        BLAS is not used, since its results depend on the processor and its idle threads keep spinning.
        """
        return np.einsum("ni,io->no", rows, matrix)

    def pool(self, rows: Any, counts: Int64s) -> Any:
        """Return the mean, maximum and minimum of the rows of each surface."""
        starts = starts_of(counts)
        least, most = np.minimum.reduceat(rows, starts), np.maximum.reduceat(rows, starts)
        return np.concatenate([np.add.reduceat(rows, starts) / counts[:, None], most, least], axis=1)

    def spread(self, rows: Any, counts: Int64s) -> Any:
        """Repeat each row."""
        return np.repeat(rows, counts, axis=0)

    def join(self, parts: Sequence[Any]) -> Any:
        """Put columns side by side."""
        return np.concatenate(parts, axis=1)


def starts_of(counts: Int64s) -> Int64s:
    """Return the first row of each surface, given the numbers of their rows."""
    return np.append(0, np.cumsum(counts)[:-1])


def forward(layers: Layers, squares: Any, counts: Int64s, even: Any) -> dict[str, Any]:
    """Return the outputs of the network for N surfaces.

    `squares` are the standardised features of the squares of all surfaces, `counts` the numbers of squares of each.
    `even` are the standardised features of even cells, shape (N, G).
    """
    inner = layers.dense(layers.dense(squares, "square 1"), "square 2")
    whole = layers.join([layers.pool(inner, counts), even])
    context = layers.dense(layers.dense(whole, "whole 1"), "whole 2")
    # One layer suffices: where noise is obvious, readings are nearly linear in the features of even cells.
    outputs = {
        name: layers.dense(context, name, is_last=True) for name in ("total", "deviations", "correlations")
    }
    place = layers.dense(layers.join([inner, layers.spread(context, counts)]), "place 1")
    outputs["places"] = layers.dense(place, "place 2", is_last=True)
    return {**outputs, "context": context}


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


def candidates_of(even: Float32s, quiet: Float32s, counts: Int64s) -> dict[str, Array]:
    """Return candidate estimates of log2(deviation + OFFSET), along the last axis.

    "total", shape (N, 1, M), and "deviations" by scale and component, shape (N, 12, M), are made from the deviations in
    even cells, shape (N, SCALES, 6, 3); "places", shape (P, 1, M), from the deviations of quiet cells, shape (P, 3),
    relative to the mean of their surface.
    """
    of_squares = log_of(4.0**quiet - FLOOR).mean(axis=1)
    of_squares -= np.repeat(np.add.reduceat(of_squares, starts_of(counts)) / counts, counts)
    places = np.stack([of_squares, np.zeros_like(of_squares)], axis=-1)
    return {**_candidates_of_even(even), "places": places[:, None]}


def _candidates_of_even(even: Float32s) -> dict[str, Array]:
    """Return the candidates "total" and "deviations" from the deviations in even cells.

    The candidates of a scale and component are its deviation by share of the cells, that of the finest scale, and those
    of the differences of channels at its scale and at the finest. Differences of channels have the least texture, and
    independent noise has the same deviation in all of them.
    """
    variances = np.maximum(4.0**even - FLOOR, 0)
    total = covariance_of_cells(np.moveaxis(variances.mean(axis=3), 1, 0))
    usual = variances[:, :, [len(EVEN_SHARES) - 1, len(EVEN_SHARES)]]
    finest = np.broadcast_to(usual[:, :1], usual.shape)
    of_differences = np.broadcast_to(usual[..., 1:].mean(axis=3, keepdims=True), usual.shape)
    of_finest = np.broadcast_to(of_differences[:, :1], usual.shape)
    deviations = np.concatenate([variances, finest, of_differences, of_finest], axis=2)
    total = np.concatenate([total, of_differences[:, 0, :, 0], of_differences[:, 1, :, 0]], axis=1)
    by_component = np.moveaxis(deviations, 2, 3).reshape(len(even), SCALES * 3, -1)
    return {"total": log_of(total[:, None]), "deviations": log_of(by_component)}


def log_of(variance: Array | float) -> Array:
    """Return log2(deviation + OFFSET) for a variance in squared 8-bit steps."""
    return np.asarray(np.log2(np.sqrt(np.maximum(variance, 0)) + OFFSET))


@dataclass(frozen=True)
class Weights:
    """The weights, and the standardisation of features."""

    layers: dict[str, Float32s]
    means: dict[str, Float32s]
    scales: dict[str, Float32s]

    def standardised(self, name: str, features: Array) -> Float32s:
        """Standardise features of a kind: "squares", "even", or the "evidence" of `size`."""
        result = (features - self.means[name]) / self.scales[name]
        return np.asarray(np.clip(result, -MAX_STANDARDISED, MAX_STANDARDISED), np.float32)

    @classmethod
    def load(cls, path: Path) -> Weights:
        """Read a file of weights that training wrote."""
        parts: dict[str, dict[str, Float32s]] = {"layer": {}, "mean": {}, "scale": {}}
        with path.open("rb") as stream, np.load(stream) as arrays:
            for key in arrays.files:
                kind, _, part = key.partition("/")
                if part:
                    parts[kind][part] = arrays[key].astype(np.float32)
            return cls(parts["layer"], parts["mean"], parts["scale"])


@cache
def weights_of(kind: str, name: str = "weights") -> Weights:
    """Return the weights for a kind of neighbourhoods, "grid" or "cluster"; "sizes": those of the network of `size`."""
    return Weights.load(Path(__file__).with_name(f"{kind}_{name}.npz"))


@dataclass(frozen=True)
class NetworkReading:
    """What the network reads of one surface; sizes of noise as log2(deviation + OFFSET), in 8-bit steps."""

    total: Array  # size of all noise by `TOTAL_QUANTILES`, shape (Q,)
    deviations: Array  # size by scale, component and `QUANTILES`, shape (SCALES, 3, 3)
    correlations: Array  # of components, as their inverse hyperbolic tangents, shape (SCALES, 3)
    places: Array  # size in each square relative to the surface, by `QUANTILES`, shape (P, 3)
    candidates: Array  # sizes that the total is combined from, shape (M,)
    context: Array  # outputs of the last layer that describes the surface, shape (C,)

    @classmethod
    def of(cls, channels: ThreeChannels, weights: Weights) -> NetworkReading:
        features, counts = Features.of(channels), np.array([channels.neighbourhoods.count])
        squares = weights.standardised("squares", features.squares)
        even = weights.standardised("even", features.even[None])
        outputs = forward(Layers(weights.layers), squares, counts, even)
        candidates = candidates_of(features.even_deviations[None], features.quiet, counts)
        read = {
            name: mixed(outputs[name].reshape(*given.shape[:-1], -1), given)
            for name, given in candidates.items()
        }
        return cls(
            total=read["total"][0, 0],
            deviations=read["deviations"][0].reshape(SCALES, 3, -1),
            correlations=outputs["correlations"][0].reshape(SCALES, 3),
            places=read["places"][:, 0],
            candidates=candidates["total"][0, 0],
            context=outputs["context"][0],
        )

    @property
    def place_logs(self) -> Float64s:
        """Medians of log2 of the relative deviations of squares, shape (P,)."""
        return _medians(self.places)

    @cached_property
    def covariances(self) -> Float64s:
        """Covariances of components by scale, shape (SCALES, 3, 3)."""
        deviations = np.maximum(2.0 ** _medians(self.deviations) - OFFSET, 1e-3)
        correlations = np.tanh(self.correlations.astype(np.float64))
        matrices = np.stack([np.eye(3)] * SCALES)
        for number, (one, other) in enumerate(PAIRS[3:]):
            matrices[:, one, other] = matrices[:, other, one] = correlations[:, number]
        values, vectors = np.linalg.eigh(matrices * deviations[:, :, None] * deviations[:, None])
        roots = vectors * np.sqrt(np.maximum(values, 0))[:, None]
        covariances: Float64s = np.einsum("lkm,ljm->lkj", roots, roots)
        return covariances


def _medians(quantiles: Array) -> Float64s:
    return np.sort(quantiles, axis=-1)[..., QUANTILES.index(0.5)].astype(np.float64)
