"""Signals that end the command: they raise an exception, so that everything is cleaned up."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import ClassVar

from beltrami_cli.signals import unhandled_signals

# Another signal within this time is a repetition, as of an impatient key, and would only disturb the tidying.
_DUPLICATE_SECONDS = 1.0
# Seconds until a signal is sent again whose exception was dropped: longer than most destructors take.
_RESEND_DELAY = 0.05


class Interruption(BaseException):
    """Ctrl-C, or another signal to end.

    A KeyboardInterrupt that passes through exec, which libraries call while they are imported, makes Python kill itself
    at its end, whatever exit code was asked for.
    """

    last: ClassVar[Interruption | None] = None  # that was raised, also if a library made another error of it

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number, self.exit_code = number, 128 + number  # as shells have it
        Interruption.last = self


class Interruptible:
    def __init__(self) -> None:
        self._last = -_DUPLICATE_SECONDS
        self._is_over = False
        self._signals: set[int] = set()
        self._usual_hook = sys.unraisablehook

    def run(self, function: Callable[[], int]) -> int:
        """Return the exit code that a function returns, or that of the signal that ended it."""
        try:
            try:
                self._start()
                code = function()
            finally:
                self._is_over = True  # from now on, signals end the process without more ado
        except Interruption as error:  # perhaps one that came just before the line above
            self._is_over = True
            code = error.exit_code
        finally:
            for number in self._signals:
                signal.signal(number, signal.SIG_DFL)
            sys.unraisablehook = self._usual_hook
        return code

    def _start(self) -> None:
        Interruption.last = None
        sys.unraisablehook = self._send_again
        self._signals = unhandled_signals()
        for number in self._signals:
            signal.signal(number, self._interrupt)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._is_over:
            os._exit(128 + number)
        if time.monotonic() - self._last >= _DUPLICATE_SECONDS:
            self._last = time.monotonic()
            raise Interruption(number)

    def _send_again(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Send a signal again whose exception Python dropped, as it does in destructors."""
        dropped = unraisable.exc_value
        if not isinstance(dropped, Interruption):
            self._usual_hook(unraisable)
            return
        self._last = -_DUPLICATE_SECONDS
        timer = threading.Timer(_RESEND_DELAY, os.kill, (os.getpid(), dropped.number))
        timer.daemon = True
        timer.start()
