"""Run libraries that malicious files can break in a process with a limit on memory and time."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, MemoryLimitError, install_hint
from beltrami_cli.formats.files.archives import most_unpacked
from beltrami_cli.surface.worker_process import Message, WorkerError, ask, serve

_TIMEOUT = 60  # seconds
_MISSING, _EXHAUSTED = 77, 78  # exit codes where a package is not installed, and where memory is used up
_LIBRARY_BYTES = 512 << 20  # bytes that they take
_BYTES_PER_PROCESSOR = 24 << 20  # bytes: the stack of a thread, and the arena of its allocations
# Memory as a multiple of the most that a file unpacks to: the data in the library, and the arrays of the answer.
# Meshes of 90,000 and 1,000,000 vertices in .usdc take 72 and 53 bytes per byte of the file; this allows 400.
_COPIES = 4


@dataclass(frozen=True)
class ForeignLibrary:
    """A library, and the module of this package that calls it in a process of its own, see `serve_files`."""

    module: str
    extra: str
    per_mebibyte: int  # seconds
    advice: str  # where it cannot read a file

    def ask(self, question: Message, name: str, size: int, memory: int | None) -> Message:
        """Return the answer about a file of `size` bytes; InputError if the library fails.

        A damaged file may request any amount of memory, so the limit is what a file of its size can need.
        """
        seconds, most = _TIMEOUT + self.per_mebibyte * (size >> 20), _COPIES * most_unpacked(size)
        allowed = most if memory is None else min(most, memory)
        try:
            return ask(self.module, question, seconds, allowed, seconds=seconds)
        except TimeoutError:
            raise InputError(name, f"it could not be read within {seconds} s", self.advice) from None
        except WorkerError as error:
            cause = str(error)[:300]
            if error.code == _EXHAUSTED and allowed < most:
                raise MemoryLimitError(name, cause, "raise --max-memory") from error
            is_missing = error.code == _MISSING
            remedy = install_hint(f"beltrami-cli[{self.extra}]") if is_missing else self.advice
            raise InputError(name, cause, remedy) from error


def serve_files(answer: Callable[[Any, dict[str, Array]], Message], files: str, package: str) -> None:
    """Answer the question of the parent process, within the limits on its command line."""
    seconds, memory = map(int, sys.argv[1:])
    _limit_memory(memory)
    try:
        serve(answer, seconds + 10)
    except ImportError as error:
        sys.stderr.write(f"to read {files} files, the package {package} is needed ({error.name})\n")
        sys.exit(_MISSING)
    except MemoryError:
        sys.stderr.write("it needs more memory than it may take, so it is large or damaged\n")
        sys.exit(_EXHAUSTED)
    except Exception as error:  # whatever the library makes of a damaged file
        said = " ".join(f"{type(error).__name__}: {error}".split())
        sys.exit(f"it is damaged, or not understood ({said[:200]})")
    os._exit(0)  # the clean-up of a library takes time and may fail


def _limit_memory(memory: int) -> None:
    try:
        import resource
    except ImportError:
        return
    most = resource.getrlimit(resource.RLIMIT_DATA)[1]
    wanted = memory + _LIBRARY_BYTES + _BYTES_PER_PROCESSOR * (os.cpu_count() or 1)
    resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))
