"""Whether surfaces are smoothed in pieces, and who runs these."""

from __future__ import annotations

import contextlib
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.partitions.exchange import Piece


class TooNarrowError(Exception):
    """A piece does not borrow enough for its kernels."""


@dataclass(frozen=True)
class Joined:
    """The values of all samples after all iterations, shape (S, N); and as in `Advance`, over all iterations."""

    values: NDArray[np.float32]
    samples: float
    truncated: int


class Runner(Protocol):
    """Who runs pieces."""

    def run(
        self,
        pieces: Sequence[Piece],
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """Run all iterations from the values of all samples, shape (S, N).

        Raises
        ------
        TooNarrowError
            If a piece says that it is not exact.
        """


class InTurn:
    """Runs pieces one after the other, with all threads for each.

    Parameters
    ----------
    threads : int
        For a piece that does not ask for a number of them.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads

    def run(
        self,
        pieces: Sequence[Piece],
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """As for `Runner`."""
        from beltrami_cli.flow.partitions.exchange import collect, plan_loans

        loans = plan_loans(pieces, len(values))
        own = [values[piece.owned] for piece in pieces]
        samples, truncated = 0.0, 0
        for iteration in range(iterations):
            lent = [
                collect(plan, [own[loan.lender][loan.rows] for loan in plan], values.shape[1])
                for plan in loans
            ]
            for number, piece in enumerate(pieces):
                step = piece.advance(own[number], lent[number], iteration, piece.threads or self._threads)
                if not step.is_exact:
                    raise TooNarrowError
                own[number] = step.values
                samples, truncated = samples + step.samples, truncated + step.truncated
                if progress is not None:
                    progress(iteration * len(pieces) + number + 1, iterations * len(pieces))
        return Joined(joined(pieces, own, values), samples, truncated)


def joined(
    pieces: Sequence[Piece], own: Sequence[NDArray[np.float32]], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the values of all samples from those of all pieces, in an array like `values`."""
    whole = np.empty_like(values)
    for piece, rows in zip(pieces, own, strict=True):
        whole[piece.owned] = rows
    return whole


@dataclass(frozen=True)
class Split:
    """Surfaces are to be smoothed in so many pieces, by a runner."""

    count: int
    runner: Runner

    def run(
        self,
        cut: Callable[[int, int], Sequence[Piece]],
        reach: int,
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """Cut a surface and run all iterations; pieces that prove too narrow are cut anew, twice as wide.

        Parameters
        ----------
        cut : callable
            Makes pieces from their number, and how far kernels may reach into what is borrowed, in neighbours.
        reach : int
            The first guess of that.
        values : ndarray of float32, shape (S, N)
            To start from.
        iterations : int
            How many.
        progress : callable, optional
            Called with the work done so far and the work to do; may raise to stop.
        """
        while True:
            try:
                return self.runner.run(cut(self.count, reach), values, iterations, progress)
            except TooNarrowError:
                reach *= 2


_WANTED: ContextVar[Split | None] = ContextVar("split", default=None)


@contextlib.contextmanager
def in_pieces(count: int, runner: Runner) -> Iterator[None]:
    """Let every surface that is smoothed meanwhile, in this thread, be smoothed in up to so many pieces.

    A dozen jobs end in a flow; none of them has to know.
    """
    token = _WANTED.set(Split(count, runner))
    try:
        yield
    finally:
        _WANTED.reset(token)


def wanted_split() -> Split | None:
    """Return how surfaces are to be split; None: not at all."""
    return _WANTED.get()
