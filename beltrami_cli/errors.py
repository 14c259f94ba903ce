"""How work ends early: the exceptions that beltrami raises, each with its exit code, and signals that end a process."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from typing import NamedTuple

_LONGEST = 1000  # characters; what a file has for a name may be a million


def one_line(text: str) -> str:
    """Return text as one line that fits any terminal; files may hold names with control characters."""
    line = "".join(character if character.isprintable() else "?" for character in text)
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"


def install_hint(requirement: str) -> str:
    """Return the command that installs a package for the Python that runs this process, as a remedy."""
    return f"install it with: {shlex.quote(sys.executable)} -m pip install {shlex.quote(requirement)}"


class Obstacle(NamedTuple):
    """Why something in a file is not used, and what can be done about it."""

    cause: str
    remedy: str = ""


class BeltramiError(Exception):
    """Base of all errors with a message for users: one line with the cause and a remedy.

    Attributes
    ----------
    exit_code : int
        What the command line exits with: 1 processing failed, 2 usage, 3 input unreadable or unsuitable,
        4 output not writable.
    name : str
        The file that the message begins with, as the user named it; empty if it is about none.
    """

    exit_code = 1

    def __init__(self, cause: str, name: str = "") -> None:
        super().__init__(f"{name}: {cause}" if name else cause)
        self.name = name


class ProcessingError(BeltramiError):
    """The input was read, but the computation could not be carried out."""


class UsageError(BeltramiError):
    """A parameter is unknown or out of its range, or two contradict each other."""

    exit_code = 2


class FileError(BeltramiError):
    """A file, named as by the user, cannot be read or written: why and where in it, and what can be done about it."""

    def __init__(self, name: str, cause: str, remedy: str = "") -> None:
        super().__init__(one_line(f"{name}: {cause}" + (f"; {remedy}" if remedy else "")))
        self.name, self.cause, self.remedy = name, one_line(cause), remedy

    def __reduce__(self) -> tuple[type[FileError], tuple[str, str, str]]:
        # Not by the message, which Exception would take: other processes make the error again.
        return type(self), (self.name, self.cause, self.remedy)


class InputError(FileError):
    """The input cannot be read, is damaged, or contains nothing that can be smoothed."""

    exit_code = 3


class MemoryLimitError(InputError):
    """The input needs more memory than it may take."""


class NoColoursError(InputError):
    """The input is sound, but has no colours of the kind that was asked for."""


class OutputError(FileError):
    """The output cannot be written, or must not be."""

    exit_code = 4


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
    """End this process by a signal when the one that started it, whose number is given, is gone; on Linux alone."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:  # it was gone before
            os.kill(os.getpid(), number)


def unhandled_signals() -> set[int]:
    """Return the signals that would end this process; ignored ones, as under nohup, are left out."""
    ends = (signal.SIG_DFL, signal.default_int_handler)
    return {number for number in ENDING_SIGNALS if signal.getsignal(number) in ends}
