"""Messages between the leading process and a worker process."""

from __future__ import annotations

import mmap
import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from beltrami_cli.batch.pool import Task

_ALIGNMENT = 64  # bytes: arrays begin at multiples of it, as C++ may ask of them


@dataclass(frozen=True)
class Order:
    """A task for a worker process; its part, if it has one, is its first argument."""

    task: Task
    arguments: tuple[Any, ...] = ()
    key: int | None = None  # of its part; None: no part
    part: Any = None  # unless the worker holds it from an earlier order
    held: frozenset[int] = frozenset()  # keys of the parts that the worker continues to hold


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
