"""Signals that ask a process to end."""

from __future__ import annotations

import signal

# Signals whose default is not to end a process, that cannot be caught, or that mean faults in native code,
# which would fault again and again if Python handled them.
_OTHERS = (
    "SIGCHLD", "SIGCONT", "SIGINFO", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGURG", "SIGWINCH",
    "SIGKILL", "SIGSTOP",
    "SIGBUS", "SIGEMT", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP",
)  # fmt: skip
ENDING_SIGNALS = frozenset(map(int, signal.valid_signals() - {getattr(signal, each, 0) for each in _OTHERS}))


def unhandled_endings() -> set[int]:
    """Return the signals that would end this process; ignored ones, as under nohup, are left out."""
    ends = (signal.SIG_DFL, signal.default_int_handler)
    return {number for number in ENDING_SIGNALS if signal.getsignal(number) in ends}
