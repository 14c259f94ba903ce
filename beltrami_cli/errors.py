"""The exceptions that beltrami raises, each with its exit code and a message of one line."""

from __future__ import annotations

import shlex
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
