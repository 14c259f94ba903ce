"""A worker process, and the messages between it and the leading process."""

from __future__ import annotations

import contextlib
import copy
import mmap
import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from beltrami_cli.batch.pool import Advance, Task
from beltrami_cli.jobs.progress import at_intervals
from beltrami_cli.signals import end_with_parent, unhandled_signals

_ALIGNMENT = 64  # bytes: arrays begin at multiples of it, as C++ may ask of them


@dataclass(frozen=True)
class Order:
    """A task for a worker process; its part, if it has one, is its first argument."""

    task: Task
    arguments: tuple[Any, ...] = ()
    key: int | None = None  # of its part; None: no part
    part: Any = None  # unless the worker keeps it from an earlier order
    kept: frozenset[int] = frozenset()  # keys of the parts that the worker continues to keep


class Channel:
    """Messages between two processes, with arrays in a file that both map: a pipe would copy them four times."""

    def __init__(self, pipe: Connection[Any, Any], path: Path) -> None:
        self.pipe, self._path, self._pages = pipe, path, memoryview(b"")

    def send(self, message: object) -> None:
        """Send a message; arrays that are not contiguous go through the pipe."""
        buffers: list[pickle.PickleBuffer] = []
        head = pickle.dumps(message, 5, buffer_callback=buffers.append)
        contents = [buffer.raw() for buffer in buffers]
        sizes = [content.nbytes for content in contents]
        for content, place in zip(contents, self._places(sizes), strict=True):
            place[:] = content
        self.pipe.send((head, sizes))

    def receive(self) -> Any:
        """Receive a message; its arrays are valid until the next one, in either direction."""
        head, sizes = self.pipe.recv()
        return pickle.loads(head, buffers=self._places(sizes))

    def _places(self, sizes: Sequence[int]) -> list[memoryview]:
        """Return the memory of arrays of these sizes in bytes, one after the other in the file."""
        *begins, end = accumulate((size + -size % _ALIGNMENT for size in sizes), initial=0)
        if end > len(self._pages):
            with self._path.open("r+b") as file:
                if hasattr(os, "posix_fallocate"):
                    # Reserves the space: otherwise a full disk would kill the process when it writes a page.
                    os.posix_fallocate(file.fileno(), 0, end)
                else:
                    file.truncate(end)
                self._pages = memoryview(mmap.mmap(file.fileno(), 0))
        return [self._pages[begin : begin + size] for begin, size in zip(begins, sizes, strict=True)]


def serve(pipe: Connection[Any, Any], path: Path) -> None:
    """Run the tasks from a channel until it is closed."""
    for number in unhandled_signals():
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    if (leader := multiprocessing.parent_process()) is not None and leader.pid is not None:
        end_with_parent(leader.pid, signal.SIGTERM)  # a signal on which it removes its files
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the leading one decides
    channel, kept = Channel(pipe, path), dict[int, Any]()  # parts by key

    def report(label: str, done: float, total: float) -> None:
        try:
            channel.send(Advance(label, done, total))
        except ConnectionError:  # the leading process is gone, which is not an error of the task
            sys.exit()

    progress = at_intervals(report)
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            order: Order = channel.receive()
            kept = {key: kept[key] for key in order.kept}
            if order.key is not None and order.part is not None:
                # The arrays of a message are valid until the next one.
                kept[order.key] = copy.deepcopy(order.part)
            parts = () if order.key is None else (kept[order.key],)
            channel.send(order.task(*parts, *order.arguments, progress))
