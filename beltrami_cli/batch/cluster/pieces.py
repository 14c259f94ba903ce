"""Pieces of one surface on the workers of a Dask scheduler, which lend each other what they need between iterations.

Values go from worker to worker. If a worker dies, what it held is gone, and the surface is begun again on the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from beltrami_cli.batch.cluster.connection import LOST
from beltrami_cli.errors import ProcessingError
from beltrami_cli.flow.partitions import Advance, Joined, TooNarrowError, collect, joined, plan_loans

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.flow.partitions import Loan, Partition

# So often a surface is begun again after workers died.
_RETRIES = 5


@dataclass(frozen=True)
class _Given:
    """A piece, what it borrows, and the version of the program that cut it, as they are sent to a worker."""

    piece: Partition
    loans: list[Loan]
    version: str


class OnCluster:
    """Runs pieces on workers; a `Runner`.

    Parameters
    ----------
    client : distributed.Client
        Connected.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def run(
        self,
        pieces: Sequence[Partition],
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """As for `Runner`.

        Raises
        ------
        TooNarrowError
            As for `Runner`.
        ProcessingError
            If workers die again and again, or there are none.
        """
        from distributed import CancelledError, KilledWorker

        for _ in range(_RETRIES):
            self._require_scheduler(None)
            try:
                return self._run(pieces, values, iterations, progress)
            except (CancelledError, KilledWorker) as error:
                last = error
            except Exception as error:  # many kinds, as Dask itself is not ready for it everywhere
                self._require_scheduler(error)
                raise
        cause = " ".join(str(last).split())
        raise ProcessingError(
            f"workers died {_RETRIES} times with pieces of the surface ({cause}); there may be too little memory there"
        )

    def _require_scheduler(self, error: Exception | None) -> None:
        if self._client.status != "running":
            raise ProcessingError(LOST) from error

    def _run(
        self,
        pieces: Sequence[Partition],
        values: NDArray[np.float32],
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        places = self._places(len(pieces))
        loans, own_version = plan_loans(pieces, len(values)), version("beltrami-cli")
        given, steps = [], []
        for piece, plan, place in zip(pieces, loans, places, strict=True):
            given.append(self._sent(_Given(piece, plan, own_version), place))
            steps.append(self._sent(Advance(values[piece.owned], 0, 0), place))
        samples, truncated = 0.0, 0
        for iteration in range(iterations):
            # Small arrays, so that a worker is sent no more of a piece than it needs.
            lent = [[self._submit(_lend, steps[loan.lender], loan.rows) for loan in plan] for plan in loans]
            steps = [
                self._submit(
                    _advance, given[number], steps[number], lent[number], iteration, values.shape[1],
                    workers=[places[number]], allow_other_workers=True,
                )
                for number in range(len(pieces))
            ]  # fmt: skip
            told = self._told(steps, iteration, iterations, progress)
            samples += sum(each[0] for each in told)
            truncated += sum(each[1] for each in told)
        own = self._client.gather([self._submit(_values, step) for step in steps])
        return Joined(joined(pieces, own, values), samples, truncated)

    def _told(
        self,
        steps: Sequence[Any],
        iteration: int,
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> list[tuple[float, int]]:
        """Wait for an iteration; return the samples held and the kernels cut short of every piece."""
        from distributed import as_completed

        counts = [self._submit(_counts, step) for step in steps]
        for number, (_, (_, _, is_exact)) in enumerate(
            as_completed(counts, with_results=True, loop=self._client.loop), 1
        ):
            if not is_exact:
                raise TooNarrowError
            if progress is not None:
                progress(iteration * len(steps) + number, iterations * len(steps))
        return [(samples, truncated) for samples, truncated, _ in self._client.gather(counts)]

    def _places(self, count: int) -> list[str]:
        """Choose a worker for every piece, each in turn."""
        self._client.wait_for_workers(1)
        workers = sorted(self._client.nthreads())
        return [workers[number % len(workers)] for number in range(count)]

    def _sent(self, value: Any, place: str) -> Any:
        return self._client.scatter(value, workers=[place], hash=False)

    def _submit(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        return self._client.submit(function, *arguments, pure=False, **options)


def _advance(
    given: _Given, step: Advance, lent: list[NDArray[np.float32]], iteration: int, width: int
) -> Advance:
    if version("beltrami-cli") != given.version:
        raise ProcessingError(f"a worker has version {version('beltrami-cli')}, not {given.version}")
    borrowed = collect(given.loans, lent, width)
    return given.piece.advance(step.values, borrowed, iteration, given.piece.threads or 1)


def _lend(step: Advance, rows: NDArray[np.int64]) -> NDArray[np.float32]:
    return step.values[rows]


def _counts(step: Advance) -> tuple[float, int, bool]:
    return step.samples, step.truncated, step.is_exact


def _values(step: Advance) -> NDArray[np.float32]:
    return step.values
