"""Signals that end the process, as an exception that lets everything be tidied up."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

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
        sys.unraisablehook = sys.__unraisablehook__

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
            sys.__unraisablehook__(unraisable)
            return
        self._last = -_SAME_WISH
        threading.Timer(_AGAIN, os.kill, (os.getpid(), error.exit_code - 128)).start()
