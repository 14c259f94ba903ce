"""Temporary files beside the files that they become: their names, and the removal of those that a killed run left.

A name is ``.NAME.MACHINE-PROCESS-LIFE-RANDOM.tmp``, where MACHINE stands for the computer and its space of process
numbers, and LIFE for the moment at which the process was started, since numbers of processes are used again. Files of
a process that still runs, or of another machine on shared storage, are left alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import socket
from functools import cache
from pathlib import Path

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
            if owner is not None and _is_gone(*owner.groups()):
                with contextlib.suppress(OSError):
                    Path(entry.path).unlink()


def _start(path: Path) -> str:
    name = os.fsencode(path.name)[:_LONGEST].decode(errors="ignore")
    return f".{name}."


def _is_gone(machine: str, process: str, life: str) -> bool:
    return machine == _machine() and _life(int(process)) != life


@cache
def _machine() -> str:
    space = ""
    with contextlib.suppress(OSError):
        space = str(Path("/proc/self/ns/pid").stat().st_ino)
    return _digest(f"{socket.gethostname()} {space}")


def _life(process: int) -> str | None:
    """Return what tells a running process from others of its number; None if there is none."""
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
