"""Writing files aside and putting them in place: the steps that `output.FileSet` is made of.

Putting written files in place needs no further disk space. If it fails for one, those before it are undone. Signals
that would end the process wait until nothing is half done.

The name of a temporary file is ``.NAME.MACHINE-PROCESS-LIFE-RANDOM.tmp``, where MACHINE stands for the computer and its
space of process numbers, and LIFE for the moment at which the process was started, since numbers of processes are used
again. Those of a process that still runs, or of another machine on shared storage, are left alone.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import shutil
import signal
import socket
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.signals import ENDING_SIGNALS

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Bytes

_LONGEST = 160  # bytes of NAME; a file's whole name has at most 255
_NAME = re.compile(r"([0-9a-f]{8})-([0-9]{1,9})-([0-9a-f]{8})-[0-9a-f]{12}\.tmp")
_START_TIME = 19  # field of /proc/PID/stat behind the name of the program, of which the first is the state
_ENDED = ("Z", "X")  # states of processes that only wait for somebody to ask how they ended


def temporary_beside(path: Path) -> Path:
    """Return a name that nobody has, beside a file."""
    process = os.getpid()
    owner = f"{_machine()}-{process}-{_life(process) or _digest('')}-{os.urandom(6).hex()}"
    return path.with_name(f"{_start(path)}{owner}.tmp")


def remove_leftovers(path: Path) -> None:
    """Remove what runs that were killed left beside a file that they were writing, as far as that is possible."""
    start = _start(path)
    with contextlib.suppress(OSError), os.scandir(path.parent) as entries:
        for entry in entries:
            owner = _NAME.fullmatch(entry.name[len(start) :]) if entry.name.startswith(start) else None
            if owner is not None and owner[1] == _machine() and _life(int(owner[2])) != owner[3]:
                with contextlib.suppress(OSError):
                    Path(entry.path).unlink()


def _start(path: Path) -> str:
    return f".{os.fsencode(path.name)[:_LONGEST].decode(errors='ignore')}."


@cache
def _machine() -> str:
    space = ""
    with contextlib.suppress(OSError):
        space = str(Path("/proc/self/ns/pid").stat().st_ino)
    return _digest(f"{socket.gethostname()} {space}")


def _life(process: int) -> str | None:
    """Return what distinguishes a running process from others of its number; None if there is none."""
    if os.name != "posix":  # where a signal that only asks would end it
        return _digest(str(process))
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return None
    except OSError:  # It is somebody else's.
        pass
    with contextlib.suppress(OSError, IndexError):
        fields = Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()
        started = fields[_START_TIME]
        return None if fields[0] in _ENDED else _digest(f"{_boot()} {started}")
    return _digest(str(process))


@cache
def _boot() -> str:
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    return ""


def _digest(text: str) -> str:
    return hashlib.blake2s(text.encode(), digest_size=4).hexdigest()


_PATIENCE, _PAUSE = 30.0, 0.02  # seconds that a run waits for another, and between two looks


@dataclass(frozen=True)
class Aside:
    """A file that is written under a temporary name, the place where it belongs, and whether it may replace a file."""

    temporary: Path
    path: Path
    overwrite: bool


def put_together(files: Sequence[Aside]) -> None:
    """Give all files their names, in this order, or none; OSError names the file that cannot be put in place."""
    with contextlib.ExitStack() as tidying, contextlib.ExitStack() as undoing:
        for file in files:
            try:
                _put(file, tidying, undoing)
            except OSError as error:
                error.filename = str(file.path)
                raise
        undoing.pop_all()


def place_of(path: Path) -> str:
    """Return what two names of one place have in common."""
    place = os.path.normcase(os.path.realpath(path.parent) + os.sep + path.name)
    return place.casefold() if sys.platform == "darwin" else place


def is_special(path: Path) -> bool:
    """Whether a path is neither a file nor a folder, such as a device or a pipe."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def check_writable(path: Path) -> None:
    """Make a file beside a path and remove it; OSError if that is not possible."""
    probe = temporary_beside(path)
    with endings_held():
        os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        probe.unlink()


@contextlib.contextmanager
def folders_locked(folders: Iterable[Path], deliver: Callable[[], None]) -> Iterator[None]:
    """Let no other run put files in place in these folders meanwhile; OSError if one does so for very long."""
    # In one order for all, so that two runs do not wait for each other. `deliver` lets signals through while it waits.
    with contextlib.ExitStack() as locks:
        for folder in sorted(set(folders)):
            try:
                descriptor = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
            except OSError:  # as on Windows, or without the right to list it
                continue
            locks.callback(os.close, descriptor)  # which unlocks it
            _lock(descriptor, folder, deliver)
        yield


def _lock(descriptor: int, folder: Path, deliver: Callable[[], None]) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        return
    end = time.monotonic() + _PATIENCE
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            deliver()
            if time.monotonic() > end:
                cause = f"another run has been putting files in place there for {_PATIENCE:.0f} s"
                raise OSError(errno.EBUSY, cause, str(folder)) from None
            time.sleep(_PAUSE)
        except OSError:  # There are no locks on this file system.
            return
        else:
            return


@contextlib.contextmanager
def endings_held() -> Iterator[Callable[[], None]]:
    """Defer signals that end the process, and return a function that delivers those that are waiting."""
    waiting: list[int] = []
    before: dict[int, signal._HANDLER] = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING_SIGNALS:  # also alarms, by which the command repeats what was lost
            handler = signal.getsignal(number)
            if handler not in (None, signal.SIG_IGN):  # None: not set from Python, so it cannot be set again
                before[number] = handler
                signal.signal(number, lambda received, _: waiting.append(received))

    def deliver() -> None:
        while waiting:
            handler = before[waiting[0]]
            if not callable(handler):  # the system's own, which ends the process
                return
            handler(waiting.pop(0), None)

    try:
        yield deliver
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in waiting:
            signal.raise_signal(number)


def make_folder(folder: Path, cleaning: contextlib.ExitStack) -> None:
    """Make a folder with all above it; they are removed again when the stack unwinds."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for each in reversed(missing):
        try:
            each.mkdir()
        except FileExistsError:  # another process was faster
            if not each.is_dir():
                raise
            continue
        cleaning.callback(_remove_empty, each)


def write_aside(file: Aside, pieces: Iterable[Bytes], deliver: Callable[[], None]) -> None:
    """Write a file under its temporary name, with the mode that a new file gets, or that of the file it replaces."""
    mode = stat.S_IMODE(file.path.stat().st_mode) if file.overwrite and file.path.exists() else None
    flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0)
    descriptor = os.open(file.temporary, flags, 0o666 if mode is None else mode)
    with os.fdopen(descriptor, "wb") as opened:
        for piece in pieces:
            deliver()
            opened.write(piece)
        opened.flush()
        os.fsync(descriptor)
    if mode is not None:
        file.temporary.chmod(mode)


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def _put(file: Aside, tidying: contextlib.ExitStack, undoing: contextlib.ExitStack) -> None:
    """Give a file its name; one stack removes what is needed no longer, the other undoes it all."""
    path = file.path
    if not file.overwrite:
        _put_new(file.temporary, path)
        undoing.callback(path.unlink, missing_ok=True)
    elif path.exists():
        kept = temporary_beside(path)
        tidying.callback(kept.unlink, missing_ok=True)
        try:
            os.link(path, kept)
        except OSError:  # where files cannot have two names
            shutil.copy2(path, kept)
        file.temporary.replace(path)
        undoing.callback(kept.replace, path)
    else:
        file.temporary.replace(path)
        undoing.callback(path.unlink, missing_ok=True)


def _put_new(temporary: Path, path: Path) -> None:
    """Give a file a name that nobody has; FileExistsError if somebody has it, or takes it at this moment."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        if not _is_same(temporary, path):  # on NFS the link may have been made, and only the answer lost
            raise
    except OSError:  # no file can have two names there
        # Only one process can make the empty file, and may then replace it.
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        try:
            temporary.replace(path)
        except OSError:
            path.unlink()
            raise
        return
    with contextlib.suppress(OSError):  # the file is in place, whether or not its other name goes
        temporary.unlink()


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False
