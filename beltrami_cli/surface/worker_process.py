"""A module of this package in a process of its own, which can be ended whatever the libraries that it uses do."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO


@dataclass(frozen=True)
class Worker:
    """A process at work."""

    process: subprocess.Popen[bytes]  # to wait for
    answer: IO[bytes]  # what it wrote to its standard output, to be read once it has ended
    said: IO[bytes]  # the same of its standard error

    def failure(self) -> str | None:
        """Return in a line why it failed, or None; it must have ended. Its answer can be read then."""
        self.said.seek(0)
        self.answer.seek(0)
        if not self.process.returncode:
            return None
        lines = self.said.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"it ended with code {self.process.returncode}"


@contextmanager
def working(module: str, job: IO[bytes], arguments: Sequence[str] = ()) -> Iterator[Worker]:
    """Run a module with the file `job` as its standard input, and end it at last."""
    # Files without a name, which are gone with the last process that has them open; pipes would fill up and stall.
    with tempfile.TemporaryFile() as answer, tempfile.TemporaryFile() as said:
        # Without -P a file in the folder where the user happens to be could stand in for a module. In a
        # session of its own the process does not see Ctrl-C, which is for this one.
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *arguments],
            stdin=job,
            stdout=answer,
            stderr=said,
            start_new_session=True,
        )
        try:
            yield Worker(process, answer, said)
        finally:
            process.kill()
            process.wait()
