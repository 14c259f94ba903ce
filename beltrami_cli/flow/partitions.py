"""Large surfaces in partitions: what each owns and receives, and the exchange between iterations.

Between two iterations every partition receives the new values of the samples around its own, so that each iteration
has the input that it would have on the whole surface. This module does not care who runs the partitions, in turn or
on many machines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Float32s, Int64s


class TooNarrowError(Exception):
    """A partition does not receive enough samples for its kernels."""


@dataclass(frozen=True)
class Advance:
    """The result of one iteration on a partition."""

    values: Float32s  # of the owned samples, shape (O, N)
    samples: float  # in all kernels
    truncated: int  # kernels that were cut short
    is_exact: bool = True  # if not, too few samples were received


class Partition(Protocol):
    """A part of a surface with S samples; it can be sent to another process."""

    owned: Int64s
    """Numbers of the samples that it computes, shape (O,)."""

    borrowed: Int64s
    """Numbers of the samples of other partitions whose values it needs before an iteration, shape (B,)."""

    threads: int | None
    """The requested number of threads; None: the runner decides."""

    def advance(self, own: Float32s, borrowed: Float32s, iteration: int, threads: int) -> Advance:
        """Run an iteration, counted from 0, on the values of its own, (O, N), and the borrowed samples, (B, N)."""


@dataclass(frozen=True)
class Transfer:
    """Rows that a partition receives from another, and their places among its borrowed samples."""

    source: int
    rows: Int64s
    places: Int64s


def plan_transfers(partitions: Sequence[Partition], count: int) -> list[list[Transfer]]:
    """Return the rows that each partition needs from each other one, on a surface with `count` samples."""
    owner, row = np.full(count, -1, np.int32), np.zeros(count, np.int64)
    for number, partition in enumerate(partitions):
        owner[partition.owned] = number
        row[partition.owned] = np.arange(len(partition.owned))
    plans = []
    for partition in partitions:
        sources = owner[partition.borrowed]
        transfers = []
        for source in np.unique(sources).tolist():
            places = np.flatnonzero(sources == source)
            transfers.append(Transfer(source, row[partition.borrowed[places]], places))
        plans.append(transfers)
    return plans


def collect(transfers: Sequence[Transfer], received: Sequence[Float32s], width: int) -> Float32s:
    """Return the rows of all transfers, arrays of shape (K, `width`), in the order of the borrowed samples."""
    values = np.empty((sum(len(transfer.places) for transfer in transfers), width), np.float32)
    for transfer, rows in zip(transfers, received, strict=True):
        values[transfer.places] = rows
    return values


def joined(partitions: Sequence[Partition], own: Sequence[Float32s], values: Float32s) -> Float32s:
    """Join the values of all partitions, in an array like `values`."""
    whole = np.empty_like(values)
    for partition, rows in zip(partitions, own, strict=True):
        whole[partition.owned] = rows
    return whole


@dataclass(frozen=True)
class Joined:
    """The values of all samples after all iterations, shape (S, N), with totals as in `Advance`."""

    values: Float32s
    samples: float
    truncated: int


class Runner(Protocol):
    """Runs the iterations of partitions."""

    def run(
        self,
        partitions: Sequence[Partition],
        values: Float32s,
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """Run all iterations from the values of all samples, shape (S, N); TooNarrowError if one is not exact."""


@dataclass(frozen=True)
class Split:
    """Surfaces are smoothed in `count` partitions, by a runner."""

    count: int
    runner: Runner
