"""Libraries that are not made for files that mean harm, in a process with a limit on memory and time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError
from beltrami_cli.surface.worker_process import Message, serve, working

_PATIENCE = 60  # seconds
_MISSING = 77  # exit code where a package is not installed
_LIBRARIES = 512 << 20  # bytes that they take


@dataclass(frozen=True)
class ForeignLibrary:
    """A library that a module of this package calls, which runs `serve_files` as a process of its own."""

    module: str
    extra: str
    per_mebibyte: int  # seconds
    advice: str  # where it cannot read a file

    def ask(self, question: Message, name: str, size: int, memory: int | None) -> Message:
        """Return its answer about a file of a size in bytes, with so much memory; InputError if there is none."""
        seconds = _PATIENCE + self.per_mebibyte * (size >> 20)
        with working(self.module, question, seconds, memory or 0) as worker:
            try:
                worker.process.wait(seconds)
            except subprocess.TimeoutExpired:
                raise InputError(name, f"it could not be read within {seconds} s", self.advice) from None
            if (cause := worker.failure()) is not None:
                is_missing = worker.process.returncode == _MISSING
                install = f"install it with: pip install 'beltrami-cli[{self.extra}]'"
                raise InputError(name, cause[:300], install if is_missing else self.advice)
            return worker.answer()


def serve_files(answer: Callable[[Any, dict[str, Array]], Message], files: str, package: str) -> None:
    """Answer the question of the process that waits, within the limits of the arguments."""
    seconds, memory = map(int, sys.argv[1:])
    _limit_memory(memory)
    try:
        serve(answer, seconds + 10)
    except ImportError as error:
        sys.stderr.write(f"to read {files} files, the package {package} is needed ({error.name})\n")
        sys.exit(_MISSING)
    except MemoryError:
        sys.exit("it needs more memory than it may take")
    except Exception as error:  # whatever the library makes of a damaged file
        said = " ".join(f"{type(error).__name__}: {error}".split())
        sys.exit(f"it is damaged, or not understood ({said[:200]})")
    os._exit(0)  # what a library does at the end takes time, and may fail


def _limit_memory(memory: int) -> None:
    if memory:
        try:
            import resource
        except ImportError:
            return
        most = resource.getrlimit(resource.RLIMIT_DATA)[1]
        wanted = memory + _LIBRARIES
        resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))
