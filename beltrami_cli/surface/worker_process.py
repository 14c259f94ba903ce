"""A module of this package in a process of its own, which can be ended whatever the libraries that it uses do.

It is asked on its standard input, and answers on its standard output. Also the folders for temporary files.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import OutputError, end_with_parent
from beltrami_cli.import_path import safe_environment

Message = tuple[Any, dict[str, Array]]
"""Words, as JSON has them, and arrays by name."""

PARENT = "BELTRAMI_PARENT"  # the variable with the number of the process that waits
_POLL = 0.1  # seconds between looks at whether a process is done or the user wants to stop


class WorkerError(Exception):
    """Why a process failed, in a line, and its exit code."""

    def __init__(self, cause: str, code: int) -> None:
        super().__init__(cause)
        self.code = code


@contextmanager
def writing_temporary_files() -> Iterator[None]:
    """Let a file that cannot be written, such as on a full disk, be an OutputError."""
    try:
        yield
    except OSError as error:
        raise unwritable(error.strerror or str(error)) from error


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a folder for temporary files, and remove it in the end; OutputError if it cannot be made."""
    from tempfile import TemporaryDirectory

    with ExitStack() as stack:
        with writing_temporary_files():
            # The work is done when it is removed, and a file that stays there is no reason to lose it.
            made = TemporaryDirectory(prefix="beltrami-", ignore_cleanup_errors=True)
            folder = stack.enter_context(made)
        yield Path(folder)


def unwritable(cause: str) -> OutputError:
    """Return the error that temporary files cannot be written."""
    remedy = "free space, or name another folder in the variable TMPDIR"
    return OutputError("temporary files", f"cannot be written ({cause})", remedy)


def ask(
    module: str, question: Message, *arguments: int, seconds: float, tick: Callable[[float], None] = lambda gone: None
) -> Message:  # fmt: skip
    """Run a module that calls `serve`, with some arguments, and return its answer.

    `tick` is called several times a second with the seconds that are gone. WorkerError if the process fails,
    TimeoutError if it has not ended after some seconds.
    """
    from concurrent.futures import ThreadPoolExecutor

    start = time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-m", module, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,  # so that it does not see Ctrl-C, which is for this process
        env=safe_environment() | {PARENT: str(os.getpid())},
    ) as process, ThreadPoolExecutor(1) as pool:  # fmt: skip
        try:
            # One call in a thread: after a timeout, another call would send nothing more of what the pipe did not hold.
            answered = pool.submit(process.communicate, _packed(question))
            while True:
                try:
                    answer, said = answered.result(_POLL)
                    break
                except TimeoutError:
                    gone = time.monotonic() - start
                if gone > seconds:
                    raise TimeoutError
                tick(gone)
        finally:
            process.kill()
            process.wait()  # Popen does not after a KeyboardInterrupt, nor the thread if that came as it began
    if process.returncode:
        lines = said.decode(errors="replace").strip().splitlines()
        cause = lines[-1] if lines else f"it ended with code {process.returncode}"
        raise WorkerError(cause, process.returncode)
    return _unpacked(answer)


def serve(answer: Callable[[Any, dict[str, Array]], Message], seconds: int) -> None:
    """Answer the question of the process that waits, within some seconds."""
    end_with_parent(int(os.environ[PARENT]))
    if hasattr(signal, "alarm"):  # where the system cannot tell that the process that waits for it was killed
        signal.alarm(seconds)
    # What a library prints must not come between the numbers.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with out:
        out.write(_packed(answer(*_unpacked(sys.stdin.buffer.read()))))


def _packed(message: Message) -> bytes:
    everything: dict[str, Any] = {"words": np.array(json.dumps(message[0])), **message[1]}
    file = io.BytesIO()
    np.savez(file, **everything)
    return file.getvalue()


def _unpacked(data: bytes) -> Message:
    with np.load(io.BytesIO(data), allow_pickle=False) as made:
        arrays = {name: made[name] for name in made.files if name != "words"}
        return json.loads(str(made["words"])), arrays
