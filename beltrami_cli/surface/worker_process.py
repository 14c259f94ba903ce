"""A module of this package in a process of its own, which can be ended whatever the libraries that it uses do.

It is asked on its standard input, and answers on its standard output; both are files.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import ProcessingError
from beltrami_cli.import_path import safe_environment

Message = tuple[Any, dict[str, Array]]
"""Words, as JSON has them, and arrays by name."""

_NO_ROOM = 74  # exit code of a process that cannot write its answer: EX_IOERR of sysexits.h


@contextmanager
def writing_temporary_files() -> Iterator[None]:
    """Let a file that cannot be written, such as on a full disk, be a ProcessingError."""
    try:
        yield
    except OSError as error:
        raise unwritable(error.strerror or str(error)) from error


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a folder for temporary files, and remove it in the end; ProcessingError if it cannot be made."""
    from tempfile import TemporaryDirectory

    with ExitStack() as stack:
        with writing_temporary_files():
            folder = stack.enter_context(TemporaryDirectory(prefix="beltrami-"))
        yield Path(folder)


def unwritable(cause: str) -> ProcessingError:
    """Return the error that temporary files cannot be written."""
    return ProcessingError(
        f"temporary files cannot be written ({cause}); free space, or name another folder in the variable TMPDIR"
    )


@dataclass(frozen=True)
class Worker:
    """A process at work."""

    process: subprocess.Popen[bytes]  # to wait for
    _written: IO[bytes]  # to its standard output
    _said: IO[bytes]  # on its standard error

    def failure(self) -> str | None:
        """Return in a line why it failed, or None; it must have ended. ProcessingError if its disk was full."""
        if self.process.returncode == _NO_ROOM:
            raise unwritable("there is no room for the result of a process")
        self._said.seek(0)
        if not self.process.returncode:
            return None
        lines = self._said.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"it ended with code {self.process.returncode}"

    def answer(self) -> Message:
        """Return its answer; it must have ended without failure."""
        self._written.seek(0)
        return _receive(self._written)


@contextmanager
def working(module: str, question: Message, *arguments: int) -> Iterator[Worker]:
    """Run a module that calls `serve`, with some arguments, and end it at last."""
    from tempfile import TemporaryFile

    # Files without a name, which are gone with the last process that has them open; pipes would fill up and stall.
    with ExitStack() as stack:
        with writing_temporary_files(), ExitStack() as files:  # which also write when they are closed
            job, written, said = (files.enter_context(TemporaryFile()) for _ in range(3))
            _send(job, question)
            job.seek(0)
            stack.enter_context(files.pop_all())
        # In a session of its own the process does not see Ctrl-C, which is for this one.
        process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=job,
            stdout=written,
            stderr=said,
            start_new_session=True,
            env=safe_environment(),
        )
        try:
            yield Worker(process, written, said)
        finally:
            process.kill()
            process.wait()


def serve(answer: Callable[[Any, dict[str, Array]], Message], seconds: int) -> None:
    """Answer the question of the process that waits, within some seconds."""
    if hasattr(signal, "alarm"):  # so that it ends even where the process that waits for it was killed
        signal.alarm(seconds)
    # What a library prints must not come between the numbers.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    answered = answer(*_receive(sys.stdin.buffer))
    try:
        with out:
            _send(out, answered)
    except OSError:
        os._exit(_NO_ROOM)


def _send(file: IO[bytes], message: Message) -> None:
    everything: dict[str, Any] = {"words": np.array(json.dumps(message[0])), **message[1]}
    np.savez(file, **everything)


def _receive(file: IO[bytes]) -> Message:
    with np.load(file, allow_pickle=False) as made:
        arrays = {name: made[name] for name in made.files if name != "words"}
        return json.loads(str(made["words"])), arrays
