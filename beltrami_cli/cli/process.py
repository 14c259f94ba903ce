"""What the system gives the process: signals that end it, and the standard streams.

A signal is an exception that lets everything be tidied up. The streams can be used whatever they were when the process
was started: closed, full, or a broken pipe. What cannot be printed on the standard error is dropped, and the work goes
on. What cannot be written to the standard output is an OutputError.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING, TextIO

from beltrami_cli.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

    from _typeshed import ReadableBuffer

_ENDINGS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_SAME_WISH = 1.0  # seconds in which another signal would only disturb the tidying
_AGAIN = 0.02  # seconds until a signal is sent again that came where no exception can pass


class Interruption(BaseException):
    """Ctrl-C, or a request to end.

    A KeyboardInterrupt that passes through exec, which libraries call while they are imported, makes Python kill itself
    at its end, whatever exit code was asked for.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number  # as shells have it


class Listener:
    """Runs a function that signals interrupt."""

    def __init__(self) -> None:
        self._last = -_SAME_WISH
        self._is_over = False
        self._heard: list[signal.Signals] = []
        self._dropped = sys.unraisablehook

    def run(self, function: Callable[[], int]) -> int:
        """Return the exit code that a function returns, or that of the signal that ended it."""
        # Both may be interrupted: what handles an interruption, and the end of it.
        try:
            try:
                self._start()
                code = function()
            except Interruption as error:
                code = error.exit_code
            finally:
                self._is_over = True
                self._stop()
        except Interruption as error:
            self._is_over = True
            code = error.exit_code
        return code

    def _start(self) -> None:
        sys.unraisablehook = self._send_again
        for number in _ENDINGS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup wants it
                self._heard.append(number)
                signal.signal(number, self._interrupt)

    def _stop(self) -> None:
        """Let what comes from now on end the process without more ado."""
        for number in self._heard:
            signal.signal(number, signal.SIG_DFL)
        sys.unraisablehook = self._dropped

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._is_over:
            os._exit(128 + number)
        if time.monotonic() - self._last >= _SAME_WISH:
            self._last = time.monotonic()
            raise Interruption(number)

    def _send_again(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Repeat a signal that came in a destructor or a callback, where Python drops exceptions."""
        error = unraisable.exc_value
        if not isinstance(error, Interruption):
            self._dropped(unraisable)
            return
        self._last = -_SAME_WISH
        threading.Timer(_AGAIN, os.kill, (os.getpid(), error.exit_code - 128)).start()


_INPUT, _OUTPUT, _ERROR = range(3)


class _RawOutput(io.FileIO):
    """Standard output, which fails once at most: nothing else is written after that."""

    _is_broken = False

    def write(self, data: ReadableBuffer) -> int:
        if self._is_broken:
            return memoryview(data).nbytes
        try:
            return super().write(data)
        except OSError as error:
            self._is_broken = True
            cause = "is closed" if error.errno == errno.EBADF else f"cannot be written ({error.strerror})"
            raise OutputError("<stdout>", cause, "free space or choose another place") from error


class _RawError(io.FileIO):
    """Standard error, which never fails."""

    def write(self, data: ReadableBuffer) -> int:
        with contextlib.suppress(OSError):
            return super().write(data)
        return memoryview(data).nbytes


def prepare_streams(*, hear_libraries: bool) -> None:
    """Replace the standard streams of this process by ones that can be used.

    Image decoders print on the standard error by themselves; unless `hear_libraries`, that is lost.
    """
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
    # What is written to a descriptor that is open for reading only is an error, and not lost.
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
    except (AttributeError, OSError, ValueError):  # It is no file.
        return False


def _apart_from_libraries() -> int:
    ours, nowhere = os.dup(_ERROR), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, _ERROR)
    os.close(nowhere)
    return ours


def _text(raw: io.FileIO, old: TextIO | None) -> TextIO:
    encoding = "utf-8" if old is None else old.encoding
    is_line_buffered = raw.isatty() or isinstance(raw, _RawError)
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, encoding=encoding, errors="backslashreplace", line_buffering=is_line_buffered
    )
