"""Files that belong together, written all or none, whatever happens on the way.

Every file is written under a temporary name beside its place; then all are renamed, which needs no more room on the
disk. If a rename fails, those before it are undone. Signals that would end the process wait until nothing is half done.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import stat
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from beltrami_cli.formats.document import Bytes

_ENDINGS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def replace_together(files: Mapping[Path, Iterable[Bytes]]) -> None:
    """Write several files, each complete under its name and all of them or none.

    Parameters
    ----------
    files : mapping of Path to iterable of bytes-like
        What they shall hold, in pieces. The last one is renamed last, so that it never names files that are not there.

    Raises
    ------
    OSError
        If anything cannot be written; then all is as it was, folders included.
    """
    with endings_held() as deliver, contextlib.ExitStack() as cleaning:
        temporaries = {}
        for path, pieces in files.items():
            _make_folder(path.parent, cleaning)
            temporaries[path] = temporary_beside(path)
            cleaning.callback(temporaries[path].unlink, missing_ok=True)
            _write_file(temporaries[path], pieces, path, deliver)
        _rename_together(temporaries)
        cleaning.pop_all()


def check_writable(folder: Path) -> None:
    """Make a file in a folder and remove it; OSError if that is not possible."""
    probe = temporary_beside(folder / "probe")
    with endings_held():
        os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        probe.unlink()


def temporary_beside(path: Path) -> Path:
    """Return a name that nobody has, beside a file."""
    return path.with_name(f".{path.name[:200]}.{os.urandom(6).hex()}.tmp")


@contextlib.contextmanager
def endings_held() -> Iterator[Callable[[], None]]:
    """Let signals that end the process wait; give a function that lets those come that have waited so far.

    Masks would not do: other threads than this one may receive a signal, and Python then obeys it in this one.
    """
    waiting: list[int] = []
    before: dict[int, signal._HANDLER] = {}
    if threading.current_thread() is threading.main_thread():
        for number in _ENDINGS:
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


def _make_folder(folder: Path, cleaning: contextlib.ExitStack) -> None:
    """Make a folder with all above it; they are removed again when the stack unwinds."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for each in reversed(missing):
        each.mkdir()
        cleaning.callback(_remove_empty, each)


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def _write_file(temporary: Path, pieces: Iterable[Bytes], final: Path, deliver: Callable[[], None]) -> None:
    # The mode that a new file gets, or that of the file to be replaced.
    mode = stat.S_IMODE(final.stat().st_mode) if final.exists() else None
    descriptor = os.open(
        temporary,
        os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0),
        0o666 if mode is None else mode,
    )
    with os.fdopen(descriptor, "wb") as file:
        for piece in pieces:
            deliver()
            file.write(piece)
        file.flush()
        os.fsync(descriptor)
    if mode is not None:
        temporary.chmod(mode)


def _rename_together(temporaries: Mapping[Path, Path]) -> None:
    """Rename all temporaries to the files that they become, or none."""
    *others, last = temporaries
    with contextlib.ExitStack() as tidying, contextlib.ExitStack() as undoing:
        for path in others:
            if path.exists():
                kept = temporary_beside(path)
                tidying.callback(kept.unlink, missing_ok=True)
                _keep(path, kept)
                temporaries[path].replace(path)
                undoing.callback(kept.replace, path)
            else:
                temporaries[path].replace(path)
                undoing.callback(path.unlink)
        temporaries[last].replace(last)
        undoing.pop_all()


def _keep(path: Path, kept: Path) -> None:
    """Give a file a second name; where files cannot have two, a copy."""
    try:
        os.link(path, kept)
    except OSError:
        shutil.copy2(path, kept)
