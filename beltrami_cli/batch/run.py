"""Smooth many files at once, whatever happens to some of them."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import TYPE_CHECKING, Protocol

from beltrami_cli.batch.job import Attempt, Outcome, failed
from beltrami_cli.batch.record import is_done, is_ours, tidy
from beltrami_cli.batch.storage import exists, make_folder_of
from beltrami_cli.batch.workers import Workers
from beltrami_cli.errors import OutputError
from beltrami_cli.flow.parameters import KernelParameters

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from beltrami_cli.batch.job import Job
    from beltrami_cli.batch.record import Record


class Watcher(Protocol):
    """Who is told how a batch goes; jobs are named by their place in it."""

    def started(self, key: int) -> None:
        """Be told that work on a file begins."""

    def advanced(self, key: int, label: str, done: int, total: int) -> None:
        """Be told how much of a file is done."""

    def postponed(self, key: int) -> None:
        """Be told that a file wants more memory than its share, and is tried alone at the end."""

    def finished(self, key: int, attempt: Attempt) -> None:
        """Be told what came of a file."""


class Crew(Protocol):
    """Who does jobs, to be used as a context; what is still in work at its end is given up."""

    threads: int | None
    """For each file, if it does not say itself; None: as many as there are."""
    queues: bool
    """Whether jobs may wait after they were given to it; then it is told of a file only how far it is."""

    def __enter__(self) -> Crew:
        """Begin."""

    def __exit__(self, *error: object) -> None:
        """End."""

    @property
    def is_full(self) -> bool:
        """Whether it takes no more jobs for now."""

    @property
    def is_busy(self) -> bool:
        """Whether it has any job."""

    def start(self, key: int, job: Job) -> None:
        """Take a job."""

    def answers(self, jobs: Callable[[int], Job]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        """Wait, and tell of a key either how far it is, or what came of it; `jobs` gives the job of a key."""


def run_batch(
    jobs: Sequence[Job],
    record: Record,
    watcher: Watcher,
    *,
    at_once: int,
    memory: int | None,
    fail_fast: bool = False,
    crew: Crew | None = None,
) -> list[Outcome]:
    """Smooth many files, each as `smooth_file` would alone.

    Parameters
    ----------
    jobs : sequence of Job
        What is to be done; their outputs differ.
    record : Record
        Where it is written down. What it says to be done, and still holds, is not done again.
    watcher : Watcher
        Who is told of it.
    at_once : int
        Files in work at the same time, each by a process of its own.
    memory : int or None
        Bytes for all together: each file has an equal share, and those for which that is not enough are done
        alone at the end, with all of it.
    fail_fast : bool
        Stop at the first failure. What is in work then is given up.
    crew : Crew, optional
        Who does the jobs, instead of processes of this machine; `at_once` and `memory` are then its concern.

    Returns
    -------
    list of Outcome
        One a job, in their order.

    Raises
    ------
    OutputError
        If the report cannot be written.
    """
    batch = _Batch(jobs, record, watcher, fail_fast=fail_fast)
    return batch.run_by(crew) if crew is not None else batch.run(at_once, memory)


class _Batch:
    def __init__(self, jobs: Sequence[Job], record: Record, watcher: Watcher, *, fail_fast: bool) -> None:
        self._jobs, self._record, self._watcher = jobs, record, watcher
        self._fail_fast, self._stopped = fail_fast, False
        self._earlier = [record.latest(job) for job in jobs]
        self._outcomes: dict[int, Outcome] = {}
        self._writers: dict[str, tuple[int, str]] = {}  # who wrote a file, and its hash

    def run(self, at_once: int, memory: int | None) -> list[Outcome]:
        waiting = self._to_do()
        count = max(1, min(at_once, len(waiting)))
        share = None if memory is None else memory // count
        threads = KernelParameters().thread_count
        larger = self._work(waiting, Workers(count, share, max(1, threads // count)), is_last=count == 1)
        self._work(larger, Workers(1, memory, threads), is_last=True)
        return self._outcomes_of_all()

    def run_by(self, crew: Crew) -> list[Outcome]:
        self._work(self._to_do(), crew, is_last=True)
        return self._outcomes_of_all()

    def _to_do(self) -> deque[int]:
        for earlier in self._earlier:
            tidy(earlier)
        return deque(key for key in range(len(self._jobs)) if not self._skips(key))

    def _outcomes_of_all(self) -> list[Outcome]:
        outcomes = [self._outcomes.get(key) or self._not_started(key) for key in range(len(self._jobs))]
        self._record.close(outcomes)
        return outcomes

    def _skips(self, key: int) -> bool:
        earlier = self._earlier[key]
        if earlier is None or not is_done(self._jobs[key], earlier):
            return False
        self._finish(key, Attempt(dataclasses.replace(earlier, status="skipped")))
        return True

    def _work(self, waiting: deque[int], crew: Crew, *, is_last: bool) -> deque[int]:
        """Do what waits, and return what wants more memory, unless this is its last chance."""
        larger: deque[int] = deque()
        with crew as workers:
            while not self._stopped and (waiting or workers.is_busy):
                while waiting and not workers.is_full and not self._stopped:
                    self._start(waiting.popleft(), workers)
                for key, told in workers.answers(self._jobs.__getitem__) if workers.is_busy else ():
                    if not isinstance(told, Attempt):
                        self._watcher.advanced(key, *told)
                    elif told.wants_memory and not is_last:
                        self._watcher.postponed(key)
                        larger.append(key)
                    else:
                        self._finish(key, told)
        return larger

    def _start(self, key: int, crew: Crew) -> None:
        job, earlier = self._jobs[key], self._earlier[key]
        overwrite = job.overwrite or is_ours(earlier)
        try:
            _make_place(job.target, overwrite=overwrite)
        except OutputError as error:
            self._finish(key, Attempt(failed(job, str(error), error.exit_code)))
            return
        if job.settings.kernel.threads is None:
            kernel = dataclasses.replace(job.settings.kernel, threads=crew.threads)
            job = dataclasses.replace(job, settings=dataclasses.replace(job.settings, kernel=kernel))
        self._record.add(Outcome(job.source, job.target, "started", job.parameters))
        crew.start(key, dataclasses.replace(job, overwrite=overwrite))
        if not crew.queues:
            self._watcher.started(key)

    def _finish(self, key: int, attempt: Attempt) -> None:
        outcome = self._checked(key, attempt.outcome)
        earlier = self._earlier[key]
        if outcome.status == "failed":
            if earlier is not None:  # what an earlier run wrote is still there, and still ours
                outcome = dataclasses.replace(outcome, written=earlier.written)
            self._stopped = self._stopped or self._fail_fast
        self._outcomes[key] = outcome
        self._record.add(outcome)
        self._watcher.finished(key, dataclasses.replace(attempt, outcome=outcome))

    def _checked(self, key: int, outcome: Outcome) -> Outcome:
        """Fail a job that wrote over what another one of this batch has written, such as a texture of the same name."""
        if outcome.status == "failed":
            return outcome
        for name, digest in outcome.written.items():
            other, theirs = self._writers.setdefault(name, (key, digest))
            if theirs != digest:
                cause = f"{name} is of {self._jobs[other].source}, too, with another content"
                remedy = "give them different folders as OUTPUT, in a manifest"
                error = OutputError(self._jobs[key].source, cause, remedy)
                return failed(self._jobs[key], str(error), error.exit_code, outcome.seconds)
        return outcome

    def _not_started(self, key: int) -> Outcome:
        """Return the outcome of a file that --fail-fast left undone; what was known of it stays known."""
        job, earlier = self._jobs[key], self._earlier[key]
        written = {} if earlier is None else earlier.written
        return Outcome(job.source, job.target, "not started", job.parameters, written=written)


def _make_place(target: str, *, overwrite: bool) -> None:
    if exists(target) and not overwrite:
        raise OutputError(target, "exists already", "choose another --out-dir or --suffix, or --overwrite")
    make_folder_of(target)
