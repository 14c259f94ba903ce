"""What a job may read: files of which kind, how large, and from where."""

from __future__ import annotations

import errno
import os
import stat
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_OPENING = (
    os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOCTTY", 0)
)


@dataclass(frozen=True)
class Access:
    """What a job may read.

    Attributes
    ----------
    outside : bool
        Whether files are followed that a model names beyond its own folder. Networks never are.
    memory : int or None
        Bytes that the job may take; None: as many as there are. Files and images that are larger are refused
        before they are read.
    note : callable or None
        Told of every file that was read as a whole, with what it held; so a job can say what its result depends on.
    bring : callable or None
        Told of every file beside a model before it is looked for; so it can be fetched from elsewhere.
    """

    outside: bool = False
    memory: int | None = None
    note: Callable[[Path, bytes], None] | None = field(default=None, compare=False)
    bring: Callable[[Path], None] | None = field(default=None, compare=False)


EVERYTHING_INSIDE = Access()
"""The default: what lies in the model's folder, of any size."""


class NotRegularError(OSError):
    """A FIFO, a device, a socket or a folder where a file should be."""


def read_regular(path: Path, access: Access, most: int = -1) -> bytes:
    """Return the content of a regular file, never waiting for anybody to write it.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    access : Access
        How large it may be.
    most : int
        Read no more than the first bytes; negative: all.

    Raises
    ------
    NotRegularError
        If it is something else than a file, which is then not read from.
    OSError
        If it cannot be read, or is larger than allowed.
    """
    # Without O_NONBLOCK, opening a FIFO that nobody writes to would wait for ever.
    descriptor = os.open(path, _OPENING)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise NotRegularError(errno.EINVAL, "it is not a regular file")
        if most < 0 and access.memory is not None and status.st_size > access.memory:
            raise OSError(errno.EFBIG, f"its {status.st_size} bytes are more than the memory it may take")
        data = file.read(most)
    if most < 0 and access.note is not None:
        access.note(path, data)
    return data
