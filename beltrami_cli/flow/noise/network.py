"""The network that reads noise from features, and its weights.

The features of each neighbourhood go through two layers; the mean, maximum and minimum of the outputs over all
neighbourhoods describe the surface, together with its most even cells. From this context the network reads the noise of
the surface and of each neighbourhood, both as quantiles of the logarithm of the deviation, and combines these with
`candidates`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.candidates import CANDIDATES, candidates_of, mixed, starts_of
from beltrami_cli.flow.noise.components import OFFSET, PAIRS, SCALES
from beltrami_cli.flow.noise.features import Features
from beltrami_cli.flow.noise.neighbourhoods import ThreeChannels

# Quantiles of the noise of the surface, and of all other readings.
TOTAL_QUANTILES = (0.05, 0.3, 0.5, 0.95)
QUANTILES = (0.05, 0.5, 0.95)

# Number of units in each layer. Those for clusters are smaller, which keeps the files of weights small.
WIDTHS = {
    "grid": {"local 1": 112, "local 2": 56, "whole 1": 112, "whole 2": 64, "place 1": 32},
    "cluster": {"local 1": 88, "local 2": 44, "whole 1": 88, "whole 2": 56, "place 1": 24},
}
# Number of outputs: quantiles, a weight for each candidate, and one for the network's own quantiles.
OUTPUTS = {
    "total": len(TOTAL_QUANTILES) + CANDIDATES["total"] + 1,
    "deviations": SCALES * 3 * (len(QUANTILES) + CANDIDATES["deviations"] + 1),
    "correlations": SCALES * 3,
    "place 2": len(QUANTILES) + CANDIDATES["places"] + 1,
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


def forward(layers: Layers, local: Any, counts: Int64s, even: Any) -> dict[str, Any]:
    """Return the outputs of the network for N surfaces.

    `local` are the standardised features of the neighbourhoods of all surfaces, and `counts` the numbers of these;
    `even` are the standardised features of even cells, shape (N, G).
    """
    inner = layers.dense(layers.dense(local, "local 1"), "local 2")
    whole = layers.join([layers.pool(inner, counts), even])
    context = layers.dense(layers.dense(whole, "whole 1"), "whole 2")
    # One layer suffices: where noise is obvious, readings are nearly linear in the features of even cells.
    outputs = {
        name: layers.dense(context, name, is_last=True) for name in ("total", "deviations", "correlations")
    }
    place = layers.dense(layers.join([inner, layers.spread(context, counts)]), "place 1")
    outputs["places"] = layers.dense(place, "place 2", is_last=True)
    return {**outputs, "context": context}


@dataclass(frozen=True)
class Weights:
    """The weights, and the standardisation of features."""

    layers: dict[str, Float32s]
    means: dict[str, Float32s]
    scales: dict[str, Float32s]

    def standardised(self, name: str, features: Array) -> Float32s:
        """Standardise features of a kind: "local", "even", or the "evidence" of `size`."""
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
    places: Array  # size in each neighbourhood relative to the surface, by `QUANTILES`, shape (P, 3)
    candidates: Array  # sizes that the total is combined from, shape (M,)
    context: Array  # outputs of the last layer that describes the surface, shape (C,)

    @classmethod
    def of(cls, channels: ThreeChannels, weights: Weights) -> NetworkReading:
        features, counts = Features.of(channels), np.array([channels.neighbourhoods.count])
        local = weights.standardised("local", features.local)
        even = weights.standardised("even", features.even[None])
        outputs = forward(Layers(weights.layers), local, counts, even)
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
        """Medians of log2 of the relative deviations of neighbourhoods, shape (P,)."""
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
