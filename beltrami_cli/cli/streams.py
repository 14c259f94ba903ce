"""Standard streams that work even if they were closed, full, or a broken pipe when the process started.

The standard output carries data only: what cannot be written to it is an OutputError. What cannot be printed on the
standard error is dropped, and the work goes on.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from typing import TYPE_CHECKING, TextIO

from beltrami_cli.errors import OutputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


_INPUT, _OUTPUT, _ERROR = range(3)


class ReaderGoneError(OutputError):
    """The standard output is no longer read, as by `head` after its last line."""


class _RawOutput(io.FileIO):
    """Standard output that fails at most once: after a failure nothing more is written."""

    _is_broken = False

    def write(self, data: ReadableBuffer) -> int:
        if self._is_broken:
            return memoryview(data).nbytes
        try:
            return super().write(data)
        except OSError as error:
            self._is_broken = True
            if error.errno == errno.EPIPE:
                raise ReaderGoneError("<stdout>", "is no longer read", "let its reader read all") from error
            cause = "is closed" if error.errno == errno.EBADF else f"cannot be written ({error.strerror})"
            raise OutputError("<stdout>", cause, "free space or choose another place") from error


class _RawError(io.FileIO):
    """Standard error that never fails."""

    def write(self, data: ReadableBuffer) -> int:
        with contextlib.suppress(OSError):
            return super().write(data)
        return memoryview(data).nbytes


def prepare_streams(*, hear_libraries: bool) -> None:
    """Replace the standard streams by safe ones; unless `hear_libraries`, the output of decoders is dropped."""
    _fill_descriptors()
    if sys.stdin is None:
        sys.stdin = open(_INPUT, closefd=False)  # noqa: SIM115
    if _is_at(sys.stdout, _OUTPUT):
        sys.stdout = _text(_RawOutput(_OUTPUT, "w", closefd=False), sys.stdout)
    if _is_at(sys.stderr, _ERROR):
        ours = _ERROR if hear_libraries else _apart_from_libraries()
        sys.stderr = _text(_RawError(ours, "w", closefd=False), sys.stderr)


def _fill_descriptors() -> None:
    """Open the descriptors that are closed, so that no file gets the number of a standard stream."""
    # Writing to a descriptor that is open for reading only is an error, so nothing is lost silently.
    for number, mode in ((_INPUT, os.O_RDONLY), (_OUTPUT, os.O_RDONLY), (_ERROR, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)


def _is_at(stream: TextIO | None, number: int) -> bool:
    """Whether a stream is that of a descriptor; None: Python found the descriptor closed."""
    if stream is None:
        return True
    try:
        return stream.fileno() == number
    except (AttributeError, OSError, ValueError):  # It is not a file.
        return False


def _apart_from_libraries() -> int:
    ours, nowhere = os.dup(_ERROR), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, _ERROR)
    os.close(nowhere)
    return ours


def _text(raw: io.FileIO, old: TextIO | None) -> TextIO:
    encoding = "utf-8" if old is None else old.encoding
    by_lines, buffered = raw.isatty() or isinstance(raw, _RawError), io.BufferedWriter(raw)
    return io.TextIOWrapper(buffered, encoding=encoding, errors="backslashreplace", line_buffering=by_lines)
