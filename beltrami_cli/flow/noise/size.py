"""The size of the noise as a distribution: whether there is any, and how strong it is.

The evidence is the reading of the first network, and the removal curve: the root mean square of what a pilot removes if
it assumes noise of 1, 1.7, ... 64 8-bit steps. The curve bends at the true noise, whereas that of texture rises evenly.
It also shows noise between hard edges, where few cells are even. A second small network turns both into the probability
that there is no noise, and into probabilities of its strength relative to the first reading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.noise.components import FLOOR, OFFSET, in_components
from beltrami_cli.flow.noise.neighbourhoods import ThreeChannels
from beltrami_cli.flow.noise.network import TOTAL_QUANTILES, Layers, NetworkReading, Weights

# Noise that pilots assume, in 8-bit steps, and its log2.
_LADDER_LOGS = np.arange(0, 6.01, 0.75)
_LADDER = 2.0**_LADDER_LOGS

# Noise at which the removal curve is sampled, as log2 of the ratio to the first reading.
_SAMPLED_LOGS = np.array([-2, -1.25, -0.5, 0, 0.5, 1.25, 2, 3])

# Edges of the bins of log2 of the strength relative to the first reading.
EDGES = np.concatenate([np.arange(-6, -2, 0.5), np.arange(-2, 2.01, 0.2), np.arange(2.5, 6.01, 0.5)])

# Quantiles of the energies of cells of 64 samples that are features.
_QUANTILES = (0.1, 0.3, 0.9)

# The layers, and the number of units of all but the last.
LAYERS = ("size 1", "size 2", "size 3")
WIDTHS = (96, 48)


def _removal_curve(channels: ThreeChannels) -> Float32s:
    """Return statistics of what pilots remove, by the noise that they assume, shape (len(_LADDER), 8).

    These are log2 of deviations relative to the assumed noise, for components and for quiet, usual and loud cells; the
    correlation of neighbours; and a measure of heavy tails.
    """
    neighbourhoods, rows = channels.neighbourhoods, []
    for assumed in _LADDER:
        pilot = neighbourhoods.pilot(channels.colours, np.full(1, assumed**2, np.float32))
        removed = channels.colours - pilot
        components = np.square(in_components(removed)).mean(axis=1)
        squares = np.square(removed).mean(axis=0)
        total, cells = squares.mean(), squares
        for scale in channels.scales[:3]:
            cells = scale.means(cells)
        is_whole = channels.scales[2].is_whole
        quantiles = np.quantile(cells[is_whole] if is_whole.any() else cells, _QUANTILES)
        deviations = np.log2(np.concatenate([components, quantiles]) + FLOOR) / 2 - np.log2(assumed)
        shared = neighbourhoods.product_of_neighbours(removed) / (total + FLOOR)
        tails = np.log2(np.mean(np.square(squares)) / max(1e-9, total**2) + 1e-3) / 4
        rows.append([*deviations, shared, tails])
    return np.array(rows, np.float32)


def evidence(channels: ThreeChannels, reading: NetworkReading) -> tuple[Float32s, float]:
    """Return the input of the second network, shape (F,), and the first reading, in 8-bit steps."""
    first = _first_reading(reading)
    log = np.log2(first + OFFSET)
    columns = [
        reading.context,
        np.sort(reading.total) - log,
        reading.candidates - log,
        [log],
        _sampled(_removal_curve(channels), first).ravel(),
        [np.log2(channels.neighbourhoods.count)],
    ]
    return np.concatenate(columns).astype(np.float32), first


def _first_reading(reading: NetworkReading) -> float:
    """Return the median of the first network.

    If it exceeds the noise of rounding, it is raised to the smallest candidate: even cells show noise that the network
    was not trained on, such as noise of opposite sign in two channels.
    """
    log = np.sort(reading.total)[TOTAL_QUANTILES.index(0.5)]
    median, least = np.maximum(2.0 ** np.array([log, reading.candidates.min()], np.float64) - OFFSET, 0)
    return float(max(median, least) if median > OFFSET else median)


def _sampled(curve: Float32s, first: float) -> Float64s:
    """Interpolate a removal curve at noise relative to the first reading."""
    logs = np.clip(np.log2(max(first, OFFSET)) + _SAMPLED_LOGS, 0, _LADDER_LOGS[-1])
    rungs = logs * ((len(_LADDER) - 1) / _LADDER_LOGS[-1])
    below = np.minimum(rungs.astype(np.intp), len(_LADDER) - 2)
    share = (rungs - below)[:, None]
    return np.asarray((1 - share) * curve[below] + share * curve[below + 1], np.float64)


@dataclass(frozen=True)
class Size:
    """The distribution of the size of noise, in 8-bit steps."""

    first: float  # reading that bins are relative to
    none: float  # probability that there is no noise
    shares: Float64s  # probabilities of the bins between `EDGES`, given that there is noise

    @classmethod
    def of(cls, channels: ThreeChannels, reading: NetworkReading, weights: Weights) -> Size:
        row, first = evidence(channels, reading)
        return sizes_of(weights, row[None], np.array([first]))[0]

    def quantile(self, share: float) -> float:
        """Return a quantile of the size, given that there is noise."""
        sums = np.append(0, np.cumsum(self.shares))
        return max(0.0, float(2 ** np.interp(share, sums, EDGES) * (self.first + OFFSET)) - OFFSET)


def sizes_of(weights: Weights, rows: Float32s, first: Float64s) -> list[Size]:
    """Read the distributions from rows of `evidence`, and their first readings."""
    values: Any = weights.standardised("evidence", rows)
    layers = Layers(weights.layers)
    for name in LAYERS:
        values = layers.dense(values, name, is_last=name == LAYERS[-1])
    exponentials: Array = np.exp(values - values.max(axis=1, keepdims=True))
    probabilities = (exponentials / exponentials.sum(axis=1, keepdims=True)).astype(np.float64)
    return [
        Size(float(reading), float(none), np.array(shares) / max(1e-12, sum(shares)))
        for reading, (none, *shares) in zip(first, probabilities, strict=True)
    ]
