"""Locks against other runs that put files in place."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

_LOCK_TIMEOUT, _LOCK_POLL = 30.0, 0.02  # seconds that a run waits for another, and between two attempts


@contextlib.contextmanager
def folders_locked(folders: Iterable[Path]) -> Iterator[None]:
    """Lock folders against other runs that move files into place; OSError if another run holds a lock for too long."""
    # In sorted order, so that two runs cannot deadlock.
    with contextlib.ExitStack() as locks:
        for folder in sorted(set(folders)):
            try:
                descriptor = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
            except OSError:  # on Windows, or without permission to list it
                continue
            locks.callback(close_descriptor, descriptor)  # which unlocks it
            end = time.monotonic() + _LOCK_TIMEOUT
            while try_lock(descriptor) is False:
                if time.monotonic() > end:
                    cause = f"another run has been putting files in place there for {_LOCK_TIMEOUT:.0f} s"
                    raise OSError(errno.EBUSY, cause, str(folder))
                time.sleep(_LOCK_POLL)
        yield


def close_descriptor(descriptor: int) -> None:
    """Close a file or folder that was not written to since it was synchronised."""
    with contextlib.suppress(OSError):
        os.close(descriptor)


def try_lock(descriptor: int) -> bool | None:
    """Lock a file or folder until it is closed; False if another process has locked it, None if there are no locks."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # Windows, and some file systems
        return None
    return True
