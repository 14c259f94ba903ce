"""Large surfaces in partitions: what each owns and borrows, and the exchange between iterations.

Between two iterations every partition is given the new values of what it borrows, so that each iteration has the input
that it would have on the whole surface. Who runs the partitions, in turn or on many machines, is of no concern here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray


class TooNarrowError(Exception):
    """A partition does not borrow enough for its kernels."""


@dataclass(frozen=True)
class Advance:
    """What an iteration made of a partition.

    The values of the samples that it owns, shape (O, N); how many samples its kernels held; how many kernels were cut
    short; and whether the values are exact: if not, it borrows too little.
    """

    values: NDArray[np.float32]
    samples: float
    truncated: int
    is_exact: bool = True


class Partition(Protocol):
    """A part of a surface with S samples; it can be sent to another process."""

    owned: NDArray[np.int64]
    """Numbers of the samples whose values it makes, shape (O,)."""

    borrowed: NDArray[np.int64]
    """Numbers of the samples of other partitions whose values it needs before an iteration, shape (B,)."""

    threads: int | None
    """How many threads were asked for; None: whoever runs it decides."""

    def advance(
        self, own: NDArray[np.float32], borrowed: NDArray[np.float32], iteration: int, threads: int
    ) -> Advance:
        """Make an iteration, counted from 0, from the values of what it owns, (O, N), and borrows, (B, N)."""


@dataclass(frozen=True)
class Loan:
    """What one partition borrows from another: the lender, the rows of what that owns, and the places they go to."""

    lender: int
    rows: NDArray[np.int64]
    places: NDArray[np.int64]


def plan_loans(partitions: Sequence[Partition], count: int) -> list[list[Loan]]:
    """Find who lends what to whom, for each partition of a surface with `count` samples."""
    owner, row = np.full(count, -1, np.int32), np.zeros(count, np.int64)
    for number, partition in enumerate(partitions):
        owner[partition.owned] = number
        row[partition.owned] = np.arange(len(partition.owned))
    plans = []
    for partition in partitions:
        lenders = owner[partition.borrowed]
        loans = []
        for lender in np.unique(lenders).tolist():
            places = np.flatnonzero(lenders == lender)
            loans.append(Loan(lender, row[partition.borrowed[places]], places))
        plans.append(loans)
    return plans


def collect(loans: Sequence[Loan], lent: Sequence[NDArray[np.float32]], width: int) -> NDArray[np.float32]:
    """Put what others lend, an array of shape (K, `width`) a loan, in the order that the borrower needs."""
    values = np.empty((sum(len(loan.places) for loan in loans), width), np.float32)
    for loan, rows in zip(loans, lent, strict=True):
        values[loan.places] = rows
    return values


def joined(
    partitions: Sequence[Partition], own: Sequence[NDArray[np.float32]], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the values of all samples from those of all partitions, in an array like `values`."""
    whole = np.empty_like(values)
    for partition, rows in zip(partitions, own, strict=True):
        whole[partition.owned] = rows
    return whole


@dataclass(frozen=True)
class Joined:
    """The values of all samples after all iterations, shape (S, N); and as in `Advance`, over all iterations."""

    values: NDArray[np.float32]
    samples: float
    truncated: int


class Runner(Protocol):
    """Who runs partitions."""

    def run(
        self,
        partitions: Sequence[Partition],
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """Run all iterations from the values of all samples, shape (S, N); TooNarrowError if one is not exact."""


class InTurn:
    """Runs partitions one after the other, with all threads for each."""

    def __init__(self, threads: int) -> None:
        self._threads = threads

    def run(
        self,
        partitions: Sequence[Partition],
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """As for `Runner`."""
        loans = plan_loans(partitions, len(values))
        own = [values[partition.owned] for partition in partitions]
        samples, truncated = 0.0, 0
        for iteration in range(iterations):
            lent = [
                collect(plan, [own[loan.lender][loan.rows] for loan in plan], values.shape[1])
                for plan in loans
            ]
            for number, partition in enumerate(partitions):
                threads = partition.threads or self._threads
                step = partition.advance(own[number], lent[number], iteration, threads)
                if not step.is_exact:
                    raise TooNarrowError
                own[number] = step.values
                samples, truncated = samples + step.samples, truncated + step.truncated
                if progress is not None:
                    progress(iteration * len(partitions) + number + 1, iterations * len(partitions))
        return Joined(joined(partitions, own, values), samples, truncated)
