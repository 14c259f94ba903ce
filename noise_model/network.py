"""The network that reads noise from features of squares, and its weights.

Each square goes through two layers; their mean, largest and smallest outputs over all squares describe the picture,
together with its most even cells. From this context the network reads the noise of the picture, of each square, and of
each channel by level, each as quantiles of the logarithm of the deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int64s
from features import LEVEL_BINS, SCALES

# Deviations are read as log2(deviation + this), both in steps of 8 bits: rounding to these has a deviation of 0.29.
OFFSET = 0.3

# Quantiles that are read of the noise of the picture, and of all other readings.
TOTAL_QUANTILES = (0.05, 0.3, 0.5, 0.95)
QUANTILES = (0.05, 0.5, 0.95)

# Units of the layers.
WIDTHS = {"square 1": 128, "square 2": 64, "whole 1": 128, "whole 2": 64, "place 1": 32, "level 1": 48}
OUTPUTS = {
    "total": len(TOTAL_QUANTILES),
    "deviations": SCALES * 3 * len(QUANTILES),
    "correlations": SCALES * 3,
    "place 2": len(QUANTILES),
    "level 2": LEVEL_BINS * len(QUANTILES),
}

# Features count by their standard deviations from the mean, up to this many.
MAX_STANDARDISED = 6.0

Value = TypeVar("Value")


class Layers(Generic[Value]):
    """The operations of the network; training records them to find gradients."""

    def __init__(self, weights: dict[str, Float32s]) -> None:
        self.weights = weights

    def dense(self, rows: Any, name: str, *, is_last: bool = False) -> Any:
        """Multiply rows by a matrix, add a bias, and cut off below 0 unless the layer is the last."""
        result = self.product(rows, self.weights[f"{name}.matrix"]) + self.weights[f"{name}.bias"]
        return result if is_last else np.maximum(result, 0)

    def product(self, rows: Any, matrix: Float32s) -> Any:
        """Multiply rows by a matrix; not by BLAS, whose results depend on the processor and whose threads spin on."""
        return np.einsum("ni,io->no", rows, matrix)

    def pool(self, rows: Any, starts: Int64s) -> Any:
        """Return the mean, largest and smallest of runs of rows."""
        counts = np.diff(np.append(starts, len(rows)))[:, None]
        least, most = np.minimum.reduceat(rows, starts), np.maximum.reduceat(rows, starts)
        return np.concatenate([np.add.reduceat(rows, starts) / counts, most, least], axis=1)

    def spread(self, rows: Any, counts: Int64s) -> Any:
        """Repeat each row."""
        return np.repeat(rows, counts, axis=0)

    def join(self, parts: Sequence[Any]) -> Any:
        """Put columns side by side."""
        return np.concatenate(parts, axis=1)


def read(
    layers: Layers[Any], squares: Any, starts: Int64s, even: Any, levels: Any, channels: int = 3
) -> dict[str, Any]:
    """Read the noise of N pictures from standardised features of all their squares, one picture after the other.

    `even` describes pictures, shape (N, F); `levels` their channels, shape (N * channels, F).
    """
    counts = np.diff(np.append(starts, len(getattr(squares, "value", squares))))
    inner = layers.dense(layers.dense(squares, "square 1"), "square 2")
    whole = layers.join([layers.pool(inner, starts), even])
    context = layers.dense(layers.dense(whole, "whole 1"), "whole 2")
    # Where noise is plain to see, readings are nearly linear in the features of even cells.
    last = layers.join([context, even])
    found = {name: layers.dense(last, name, is_last=True) for name in ("total", "deviations", "correlations")}
    place = layers.dense(layers.join([inner, layers.spread(context, counts)]), "place 1")
    by_channel = layers.spread(context, np.full(len(starts), channels))
    level = layers.dense(layers.join([levels, by_channel]), "level 1")
    found["places"] = layers.dense(place, "place 2", is_last=True)
    found["levels"] = layers.dense(level, "level 2", is_last=True)
    return found


@dataclass(frozen=True)
class Weights:
    """The weights, how features are standardised, and the hash of the configuration that they were trained by."""

    layers: dict[str, Float32s]
    means: dict[str, Float32s]
    scales: dict[str, Float32s]
    configuration: str

    def standardised(self, name: str, features: Array) -> Float32s:
        """Standardise features of a kind: "squares", "even" or "levels"."""
        result = (features - self.means[name]) / self.scales[name]
        return np.asarray(np.clip(result, -MAX_STANDARDISED, MAX_STANDARDISED), np.float32)

    def save(self, path: str) -> None:
        """Write a file that `load` reads; half precision is enough for weights."""
        arrays: dict[str, Any] = {
            f"layer/{name}": values.astype(np.float16) for name, values in self.layers.items()
        }
        for kind, parts in (("mean", self.means), ("scale", self.scales)):
            arrays |= {f"{kind}/{name}": values.astype(np.float32) for name, values in parts.items()}
        np.savez_compressed(path, configuration=np.array(self.configuration), **arrays)

    @classmethod
    def load(cls, path: Any) -> Weights:
        """Read the file that `save` wrote."""
        parts: dict[str, dict[str, Float32s]] = {"layer": {}, "mean": {}, "scale": {}}
        with path.open("rb") as stream, np.load(stream) as arrays:
            for key in arrays.files:
                kind, _, part = key.partition("/")
                if part:
                    parts[kind][part] = arrays[key].astype(np.float32)
            return cls(parts["layer"], parts["mean"], parts["scale"], str(arrays["configuration"]))


@cache
def weights_of_grids() -> Weights:
    """Return the weights for neighbourhoods of grids."""
    return Weights.load(Path(__file__).with_name("grid_weights.npz"))
