"""Tasks for workers that may die: in processes of this machine, here, or on a Dask scheduler, see `cluster.py`.

The pool of the standard library fails everything when a process dies, as it does when the system runs out of memory.
Here each has a pipe of its own to the process that leads, which alone decides, in one thread; one that dies loses only
its own task.
"""

from __future__ import annotations

import contextlib
import copy
import io
import mmap
import multiprocessing
import os
import pickle
import signal
import sys
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, count
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, cast

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import ProcessingError, unhandled_endings
from beltrami_cli.formats.image.reading import scratch_file
from beltrami_cli.jobs.job import at_intervals

_GRACE = 5.0  # seconds: enough to remove files that were not finished
_PAUSE = 0.1  # seconds between two messages on progress
_ALIGNMENT = 64  # bytes: arrays begin at multiples of it, as C++ may ask of them

Task = Callable[..., Any]  # called with the arguments that it was started with, and a progress


@dataclass(frozen=True)
class Lost:
    """What comes of a task whose worker died, or could not do it: the cause, in words."""

    cause: str
    wants_memory: bool = False  # whether more memory might help


class Pool(ABC):
    """Workers that do tasks."""

    @property
    @abstractmethod
    def is_full(self) -> bool:
        """Whether it takes no more tasks for now."""

    def prepare(self, tasks: int) -> None:
        """Have workers ready for as many tasks at a time."""
        del tasks

    @abstractmethod
    def start(self, key: int, task: Task, *arguments: Any) -> None: ...

    @abstractmethod
    def events(self) -> Iterator[tuple[int, Any]]:
        """Wait for a while, and give by the keys of tasks their progress, a tuple of three, or what came of them."""

    def share(self, make: Callable[[], Any]) -> Any:
        """Return what stands for a large value among the arguments of tasks; workers hold it while it is kept here."""
        return make()

    def choose(self, keys: Sequence[int], shared: Mapping[int, Any]) -> int:
        """Return which of some tasks to start next; `shared`: by key, an argument of tasks that workers may hold."""
        del shared
        return keys[0]

    @abstractmethod
    def give_up(self) -> None:
        """Stop the tasks in work: what comes of them is not wanted any more."""

    def close(self) -> None:
        """Let the workers go, after they have cleaned up."""
        self.give_up()


@dataclass(eq=False)
class Shared:
    """A value that workers hold, while it is referenced in the process that leads, which makes it for each of them."""

    number: int
    value: Any  # in the process that leads, what makes it


class _Pickler(pickle.Pickler):
    """Leaves arrays out, which are in `arrays` then."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, 5)
        self.arrays: list[Array] = []

    def persistent_id(self, obj: Any) -> tuple[int, np.dtype[Any], tuple[int, ...]] | None:
        if type(obj) is not np.ndarray or obj.dtype.hasobject:
            return None
        self.arrays.append(obj)
        return len(self.arrays) - 1, obj.dtype, obj.shape


class _Unpickler(pickle.Unpickler):
    def __init__(self, head: bytes, places: Sequence[memoryview]) -> None:
        super().__init__(io.BytesIO(head))
        self._places = places

    def persistent_load(self, pid: Any) -> Array:
        number, kind, shape = pid
        return np.frombuffer(self._places[number], kind).reshape(shape)


class Channel:
    """Messages between two processes, whose arrays are in a file that both map: a pipe would copy them four times."""

    def __init__(self, pipe: Connection[Any, Any], path: Path) -> None:
        self.pipe, self._path, self._pages = pipe, path, memoryview(b"")

    def send(self, message: object) -> None:
        head = io.BytesIO()
        pickler = _Pickler(head)
        pickler.dump(message)
        sizes = [array.nbytes for array in pickler.arrays]
        for array, place in zip(pickler.arrays, self._places(sizes, is_new=True), strict=True):
            np.frombuffer(place, array.dtype).reshape(array.shape)[...] = array
        self.pipe.send((head.getvalue(), sizes))

    def receive(self) -> Any:
        """Return a message; its arrays last until the next one, in either direction."""
        head, sizes = self.pipe.recv()
        return _Unpickler(head, self._places(sizes, is_new=False)).load()

    def _places(self, sizes: Sequence[int], *, is_new: bool) -> list[memoryview]:
        """Return where arrays of these sizes in bytes are in the file."""
        ends = list(accumulate(size + -size % _ALIGNMENT for size in sizes))
        size = ends[-1] if ends else 0
        if size > len(self._pages):
            with self._path.open("r+b") as file:
                if is_new and hasattr(os, "posix_fallocate"):
                    # Without it, full storage would end the process as it writes a page.
                    os.posix_fallocate(file.fileno(), 0, size)
                elif is_new:
                    file.truncate(size)
                self._pages = memoryview(mmap.mmap(file.fileno(), 0))
        return [self._pages[begin : begin + size] for begin, size in zip([0, *ends], sizes, strict=False)]


@dataclass
class _Worker:
    process: SpawnProcess
    channel: Channel
    file: contextlib.ExitStack  # of the channel
    key: int = -1
    held: set[int] = field(default_factory=set)  # numbers of shared values

    @classmethod
    def started(cls) -> _Worker:
        context = multiprocessing.get_context("spawn")  # a fork would copy locks of threads as they are
        with contextlib.ExitStack() as file:
            path = file.enter_context(scratch_file())
            ours, theirs = context.Pipe()
            process = context.Process(target=serve, args=(theirs, path), daemon=True)
            with _without_interrupts():
                process.start()
            theirs.close()  # so that the pipe ends with the process
            return cls(process, Channel(ours, path), file.pop_all())

    def needed(self, shared: Shared) -> Shared:
        """Return a shared value, without the value if it is here already."""
        return Shared(shared.number, None if shared.number in self.held else shared.value())

    def close(self) -> None:
        self.process.join()
        self.channel.pipe.close()
        self.file.close()


class Processes(Pool):
    """Processes of this machine, up to `most`, which are started when they are needed.

    `grace`: seconds that they have to clean up when they are asked to end.
    """

    def __init__(self, most: int, grace: float = _GRACE) -> None:
        self._most, self._grace = most, grace
        self._idle: list[_Worker] = []
        self._busy: dict[Connection[Any, Any], _Worker] = {}
        self._shared, self._numbers = weakref.WeakSet[Any](), count()

    @property
    def is_full(self) -> bool:
        return len(self._busy) >= self._most

    def prepare(self, tasks: int) -> None:
        missing = min(tasks, self._most) - len(self._idle) - len(self._busy)
        self._idle.extend(_Worker.started() for _ in range(missing))

    def start(self, key: int, task: Task, *arguments: Any) -> None:
        while True:
            worker = self._idle.pop() if self._idle else _Worker.started()
            sent = [worker.needed(each) if isinstance(each, Shared) else each for each in arguments]
            try:
                worker.channel.send((task, sent, {each.number for each in self._shared}))
                break
            except ConnectionError:  # it died while it had nothing to do
                worker.close()
            except OSError as error:
                self._idle.append(worker)
                cause = f"there is no room for a piece in work ({error.strerror})"
                raise ProcessingError(f"{cause}; lower --jobs, or raise --pieces") from error
        worker.key = key
        worker.held |= {each.number for each in arguments if isinstance(each, Shared)}
        self._busy[worker.channel.pipe] = worker

    def events(self) -> Iterator[tuple[int, Any]]:
        for pipe in wait(list(self._busy)):
            worker = self._busy[cast("Connection[Any, Any]", pipe)]
            try:
                is_done, event = worker.channel.receive()
            except (EOFError, OSError):
                event = _lost(self._busy.pop(worker.channel.pipe))
            else:
                if is_done:
                    self._idle.append(self._busy.pop(worker.channel.pipe))
            yield worker.key, event

    def share(self, make: Callable[[], Any]) -> Shared:
        shared = Shared(next(self._numbers), make)
        self._shared.add(shared)
        return shared

    def choose(self, keys: Sequence[int], shared: Mapping[int, Shared]) -> int:
        own = self._idle[-1].held if self._idle else set[int]()
        all_held = own.union(*(each.held for each in (*self._idle, *self._busy.values())))
        numbers = {key: shared[key].number if key in shared else -1 for key in keys}
        return min(keys, key=lambda key: (numbers[key] not in own, numbers[key] in all_held))

    def give_up(self) -> None:
        _end(list(self._busy.values()), 0)
        self._busy.clear()

    def close(self) -> None:
        _end([*self._idle, *self._busy.values()], self._grace)
        self._idle.clear()
        self._busy.clear()


def _lost(worker: _Worker) -> Lost:
    worker.close()
    code = worker.process.exitcode or 0
    how = f"by signal {-code}" if code < 0 else f"with code {code}"
    return Lost(f"the process that worked on it ended {how}; there may be too little memory", True)


def _end(workers: list[_Worker], grace: float) -> None:
    """End processes, which have some seconds to clean up."""
    for worker in workers if grace else ():
        worker.process.terminate()
    deadline = time.monotonic() + grace
    for worker in workers:
        if grace:
            worker.process.join(max(0.0, deadline - time.monotonic()))
        worker.process.kill()
        worker.close()


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Start processes that Ctrl-C, which reaches all, does not end with a traceback while they load their modules."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which would let the signal through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# ---- in a worker process
class _Stopped(BaseException):
    """The process that this one works for is gone."""


def serve(pipe: Connection[Any, Any], path: Path) -> None:
    """Do the tasks that come through a channel until it is closed."""
    for number in unhandled_endings():
        signal.signal(number, _exit)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; who leads decides
    channel, held = Channel(pipe, path), dict[int, Any]()
    progress = at_intervals(_PAUSE, lambda *event: _answer(channel, (False, event)))
    with contextlib.suppress(EOFError, ConnectionError, _Stopped):
        while True:
            task, arguments, referenced = channel.receive()
            held = {number: value for number, value in held.items() if number in referenced}
            shared = [each for each in arguments if isinstance(each, Shared)]
            held |= {each.number: copy.deepcopy(each.value) for each in shared if each.number not in held}
            values = [held[each.number] if isinstance(each, Shared) else each for each in arguments]
            _answer(channel, (True, task(*values, progress)))


def _answer(channel: Channel, message: object) -> None:
    try:
        channel.send(message)
    except ConnectionError:  # the other end is closed, which is no error of a task
        raise _Stopped from None


def _exit(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)
