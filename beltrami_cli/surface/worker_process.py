"""A module of this package in a separate process, which can be killed whatever its libraries do.

It reads a question from standard input and writes the answer to standard output.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.import_path import safe_environment
from beltrami_cli.signals import end_with_parent

Message = tuple[Any, dict[str, Array]]
"""Data in JSON types, and arrays by name."""

PARENT = "BELTRAMI_PARENT"  # environment variable with the id of the waiting process
_POLL = 0.1  # seconds between checks for the end of a process or an interruption


class WorkerError(Exception):
    """Failure of a process: one line of explanation, and its exit code."""

    def __init__(self, cause: str, code: int) -> None:
        super().__init__(cause)
        self.code = code


def ask(
    module: str, question: Message, *arguments: int, seconds: float, tick: Callable[[float], None] = lambda gone: None
) -> Message:  # fmt: skip
    """Run a module that calls `serve`, with a question, and return its answer.

    `tick` is called several times a second with the elapsed seconds. WorkerError if the process fails, TimeoutError if
    it exceeds `seconds`.
    """
    from concurrent.futures import ThreadPoolExecutor

    start = time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-m", module, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,  # keeps Ctrl-C from the process
        env=safe_environment() | {PARENT: str(os.getpid())},
    ) as process, ThreadPoolExecutor(1) as pool:  # fmt: skip
        try:
            # A single `communicate` in a thread: a second call after a timeout would not send the rest of the input.
            answered = pool.submit(process.communicate, _packed(question))
            while True:
                try:
                    answer, output = answered.result(_POLL)
                    break
                except TimeoutError:
                    gone = time.monotonic() - start
                if gone > seconds:
                    raise TimeoutError
                tick(gone)
        finally:
            process.kill()
            process.wait()  # neither Popen nor the thread waits after a KeyboardInterrupt
    if process.returncode:
        lines = output.decode(errors="replace").strip().splitlines()
        cause = lines[-1] if lines else f"it ended with code {process.returncode}"
        raise WorkerError(cause, process.returncode)
    return _unpacked(answer)


def serve(answer: Callable[[Any, dict[str, Array]], Message], seconds: int) -> None:
    """Answer the question of the waiting process within a number of seconds."""
    end_with_parent(int(os.environ[PARENT]))
    if hasattr(signal, "alarm"):  # a timeout in case the waiting process was killed
        signal.alarm(seconds)
    # Output of libraries must not mix with the answer.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with out:
        out.write(_packed(answer(*_unpacked(sys.stdin.buffer.read()))))


def _packed(message: Message) -> bytes:
    data, arrays = message
    file = io.BytesIO()
    # Without names, which could be those of parameters of `numpy.savez`.
    np.savez(file, np.array(json.dumps([data, [*arrays]])), *arrays.values())
    return file.getvalue()


def _unpacked(data: bytes) -> Message:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        head, *arrays = (archive[name] for name in archive.files)
    content, names = json.loads(str(head))
    return content, dict(zip(names, arrays, strict=True))
