"""Files on the workers of a Dask scheduler."""

from __future__ import annotations

import dataclasses
import queue
import uuid
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltrami_cli.batch.cluster.connection import LOST
from beltrami_cli.batch.cluster.task import do_on_worker
from beltrami_cli.batch.job import Attempt, failed
from beltrami_cli.batch.storage import is_url, place_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from beltrami_cli.batch.job import Job

_PAUSE = 1.0  # seconds between two looks whether the scheduler is still there


class ClusterCrew:
    """Has every file done by some worker; a `Crew`.

    A file whose worker dies is given to another one by the scheduler, until that happened too often (its setting
    distributed.scheduler.allowed-failures).

    Parameters
    ----------
    client : distributed.Client
        Connected.
    at_once : int or None
        Files at the same time; None: all are given to the scheduler, whose workers do one for each of their threads.
    memory : int or None
        Bytes for each file; None: by the limits of the workers.
    """

    queues = True

    def __init__(self, client: Any, at_once: int | None, memory: int | None) -> None:
        self.threads: int | None = 1  # a worker does as many files at once as it has threads
        self._client, self._at_once, self._memory = client, at_once, memory
        self._topic = f"beltrami-{uuid.uuid4().hex}"
        self._told: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self._futures: dict[int, Any] = {}

    def __enter__(self) -> ClusterCrew:
        self._client.subscribe_topic(self._topic, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        self._client.cancel(list(self._futures.values()), force=True)
        self._client.unsubscribe_topic(self._topic)

    @property
    def is_full(self) -> bool:
        """Whether so many files are in work as may be."""
        return self._at_once is not None and len(self._futures) >= self._at_once

    @property
    def is_busy(self) -> bool:
        """Whether any file is."""
        return bool(self._futures)

    def start(self, key: int, job: Job) -> None:
        """Give a file to the scheduler."""
        future = self._client.submit(
            do_on_worker, for_others(job), self._memory, self._topic, key, version("beltrami-cli"),
            key=f"{self._topic}-{key}", pure=False,
        )  # fmt: skip
        self._futures[key] = future
        future.add_done_callback(partial(self._end, key))

    def answers(self, jobs: Callable[[int], Job]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        """Wait, and tell of a key either how far it is, or what came of it."""
        try:
            key, told = self._told.get(timeout=_PAUSE)
        except queue.Empty:
            if self._client.status != "running" and self._client.status != "connecting":
                for key in list(self._futures):
                    yield key, self._lost(key, jobs(key), LOST)
            return
        if key not in self._futures:
            return
        if isinstance(told, tuple):
            yield key, told
            return
        yield key, self._attempt(key, jobs(key))

    def _attempt(self, key: int, job: Job) -> Attempt:
        from distributed import CancelledError, KilledWorker

        future = self._futures[key]
        try:
            attempt: Attempt = future.result(timeout=60)
        except KilledWorker as error:
            # The last of them died with this file in work: it may be what they died of.
            cause = f"every worker that had it in work died, the last one at {error.last_worker.address}"
            return self._lost(key, job, f"{cause}; there may be too little memory")
        except CancelledError:
            return self._lost(key, job, f"{LOST}, or the work was cancelled there")
        except Exception as error:
            return self._lost(key, job, " ".join(f"{type(error).__name__}: {error}".split()))
        del self._futures[key]
        sent = for_others(job)
        outcome = dataclasses.replace(
            attempt.outcome,
            input=job.source,
            output=job.target,
            parameters_sha256=job.parameters,
            error=attempt.outcome.error.replace(sent.source, job.source).replace(sent.target, job.target),
        )
        return dataclasses.replace(attempt, outcome=outcome)

    def _lost(self, key: int, job: Job, cause: str) -> Attempt:
        del self._futures[key]
        return Attempt(failed(job, f"{job.source}: {cause}", 1))

    def _note(self, event: tuple[float, list[Any]]) -> None:
        key, label, done, total = event[1]
        self._told.put((key, (label, done, total)))

    def _end(self, key: int, future: Any) -> None:
        self._told.put((key, None))


def for_others(job: Job) -> Job:
    """Return the job with paths that mean the same everywhere, if the files are on shared storage."""
    settings = job.settings
    guides = tuple(_everywhere(guide) for guide in settings.embedding.guides)
    image = dataclasses.replace(
        settings.image,
        **{name: _everywhere(getattr(settings.image, name)) for name in ("height", "positions", "mask")},
    )
    level_set = dataclasses.replace(settings.level_set, colours=_everywhere(settings.level_set.colours))
    return dataclasses.replace(
        job,
        source=job.source if is_url(job.source) else str(Path(job.source).absolute()),
        target=place_of(job.target),
        settings=dataclasses.replace(
            settings,
            embedding=dataclasses.replace(settings.embedding, guides=guides),
            image=image,
            level_set=level_set,
        ),
    )


def _everywhere(value: Any) -> Any:
    """Return the absolute path where a setting names a file."""
    return str(Path(value).absolute()) if isinstance(value, str) and Path(value).is_file() else value
