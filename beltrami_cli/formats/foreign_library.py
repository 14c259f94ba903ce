"""Libraries that are not made for files that mean harm, in a process with a limit on memory and time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError
from beltrami_cli.surface.worker_process import working

Message = tuple[Any, dict[str, Array]]  # words, as JSON has them, and arrays by name

_PATIENCE = 60  # seconds
_MISSING = 77  # exit code where a package is not installed
_LIBRARIES = 512 << 20  # bytes that they take


@dataclass(frozen=True)
class ForeignLibrary:
    """A library that a module of this package calls, which runs `serve` as a process of its own."""

    module: str
    extra: str
    per_mebibyte: int  # seconds
    advice: str  # where it cannot read a file

    def ask(self, question: Message, name: str, size: int, memory: int | None) -> Message:
        """Return its answer about a file of a size in bytes, with so much memory; InputError if there is none."""
        seconds = _PATIENCE + self.per_mebibyte * (size >> 20)
        with tempfile.TemporaryFile() as job:
            _send(job, question)
            job.seek(0)
            with working(self.module, job, [str(seconds), str(memory or 0)]) as worker:
                try:
                    worker.process.wait(seconds)
                except subprocess.TimeoutExpired:
                    raise InputError(name, f"it could not be read within {seconds} s", self.advice) from None
                if (cause := worker.failure()) is not None:
                    is_missing = worker.process.returncode == _MISSING
                    install = f"install it with: pip install 'beltrami-cli[{self.extra}]'"
                    raise InputError(name, cause[:300], install if is_missing else self.advice)
                return _receive(worker.answer)


def serve(answer: Callable[[Any, dict[str, Array]], Message], files: str, package: str) -> None:
    """Answer the question on standard input, on standard output, within the limits of the arguments."""
    _limit_process(*map(int, sys.argv[1:]))
    # What a library prints must not come between the numbers.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        answered = answer(*_receive(sys.stdin.buffer))
    except ImportError as error:
        sys.stderr.write(f"to read {files} files, the package {package} is needed ({error.name})\n")
        sys.exit(_MISSING)
    except MemoryError:
        sys.exit("it needs more memory than it may take")
    except Exception as error:  # whatever the library makes of a damaged file
        said = " ".join(f"{type(error).__name__}: {error}".split())
        sys.exit(f"it is damaged, or not understood ({said[:200]})")
    with out:
        _send(out, answered)
    os._exit(0)  # what a library does at the end takes time, and may fail


def _send(file: IO[bytes], message: Message) -> None:
    everything: dict[str, Any] = {"words": np.array(json.dumps(message[0])), **message[1]}
    np.savez(file, **everything)


def _receive(file: IO[bytes]) -> Message:
    with np.load(file, allow_pickle=False) as made:
        arrays = {name: made[name] for name in made.files if name != "words"}
        return json.loads(str(made["words"])), arrays


def _limit_process(seconds: int, memory: int) -> None:
    if hasattr(signal, "alarm"):  # so that it ends even where the process that waits for it was killed
        signal.alarm(seconds + 10)
    if memory:
        try:
            import resource
        except ImportError:
            return
        most = resource.getrlimit(resource.RLIMIT_DATA)[1]
        wanted = memory + _LIBRARIES
        resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))
