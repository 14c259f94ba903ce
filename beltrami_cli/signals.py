"""Signals that end a process: which they are, deferred ones, and the end of a process with its parent."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator

# Signals whose default is not to end a process, that cannot be caught, or that mean faults in native code,
# which would fault again and again if Python handled them.
_NOT_ENDING = (
    "SIGCHLD", "SIGCONT", "SIGINFO", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGURG", "SIGWINCH",
    "SIGKILL", "SIGSTOP",
    "SIGBUS", "SIGEMT", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP",
)  # fmt: skip
ENDING_SIGNALS = frozenset(
    map(int, signal.valid_signals() - {getattr(signal, each, 0) for each in _NOT_ENDING})
)
_PR_SET_PDEATHSIG = 1  # of <sys/prctl.h>


def end_with_parent(parent: int, number: int = signal.SIGKILL) -> None:
    """Have a signal end this process when its parent ends, which has the given number; on Linux alone."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:  # it was gone before
            os.kill(os.getpid(), number)


def unhandled_signals() -> set[int]:
    """Return the signals that would end this process; ignored ones, as under nohup, are left out."""
    ends = (signal.SIG_DFL, signal.default_int_handler)
    return {number for number in ENDING_SIGNALS if signal.getsignal(number) in ends}


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Defer signals that end the process."""
    waiting: list[int] = []
    before: dict[int, signal._HANDLER] = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING_SIGNALS:  # also alarms, by which the command repeats what was lost
            handler = signal.getsignal(number)
            if handler not in (None, signal.SIG_IGN):  # None: not set from Python, so it cannot be restored
                before[number] = handler
                signal.signal(number, lambda received, _: waiting.append(received))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in waiting:
            signal.raise_signal(number)
