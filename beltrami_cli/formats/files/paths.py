"""Paths and URLs of any files: whether one exists, and how it is opened."""

from __future__ import annotations

import errno
import os
import re
import stat
from io import BufferedReader
from pathlib import Path

# Without O_NONBLOCK, opening a FIFO without a writer would wait for ever.
_OPEN_FLAGS = (
    os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOCTTY", 0)
)
_URL = re.compile(r"(?!(?:file|local):)[a-z][a-z0-9+.-]+://", re.IGNORECASE)


class NotRegularError(OSError):
    """A FIFO, a device, a socket or a folder where a file should be."""


def is_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file exists; False for names that no file can have."""
    return os.path.isfile(path)  # noqa: PTH113


def is_there(path: str | os.PathLike[str]) -> bool:
    """Whether a file or folder exists; False as for `is_file`."""
    return os.path.exists(path)  # noqa: PTH110


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file, never waiting for a writer; OSError if it cannot be opened or is not regular."""
    file = os.fdopen(os.open(path, _OPEN_FLAGS), "rb")
    try:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise NotRegularError(errno.EINVAL, "it is not a regular file")
    except OSError:
        file.close()
        raise
    return file


def is_url(name: str) -> bool:
    """Whether a name is a URL of something other than a local file."""
    return _URL.match(name) is not None
