"""The memory of this process: how much it may take, a limit on it, and how much it took."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from beltrami_cli.errors import MemoryLimitError
from beltrami_cli.quantities import show_size

_MIN_MEMORY = 1 << 26  # bytes that a command needs in any case
_STATUS = Path("/proc/self/status")
_MEMORY, _OWN_CGROUPS, _CGROUPS = Path("/proc/meminfo"), Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
# Bytes that the program itself takes: its libraries and the reserve of its core (4 MiB), and for each processor the
# stacks of its threads.
_PROGRAM, _PER_PROCESSOR = 164 << 20, 24 << 20


def default_memory() -> int | None:
    """Return half of the memory available to this process, in bytes; None if it is unknown."""
    known = [size for size in (_available(), *_left_in_cgroups()) if size is not None]
    return max(min(known) // 2, _MIN_MEMORY) if known else None


def _available() -> int | None:
    """Return the bytes that the system can provide without swapping, or else all of its memory."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in _MEMORY.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    with contextlib.suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _left_in_cgroups() -> Iterator[int]:
    """Yield the bytes left under each cgroup limit of this process, for both cgroup versions."""
    lines: list[str] = []
    with contextlib.suppress(OSError, ValueError):
        lines = _OWN_CGROUPS.read_text().splitlines()
    for line in lines:
        _, controllers, path = (*line.split(":", 2), "", "")[:3]
        if controllers == "":
            root, most, current = _CGROUPS, "memory.max", "memory.current"
        elif "memory" in controllers.split(","):
            root, most, current = _CGROUPS / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        cgroup = root / path.strip("/")
        for folder in (cgroup, *cgroup.parents):
            if folder.is_relative_to(root):
                with contextlib.suppress(OSError, ValueError):  # "max" is not a limit
                    limit = int((folder / most).read_text())
                    yield max(limit - int((folder / current).read_text()) + _cached(folder), 0)


def _cached(folder: Path) -> int:
    """Return the bytes of a cgroup's file cache, which is evicted when memory is needed."""
    with contextlib.suppress(OSError, ValueError):
        fields = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
        return int(fields.get("inactive_file", 0)) + int(fields.get("active_file", 0))
    return 0


@contextmanager
def limited_memory(size: int | None, name: str) -> Iterator[None]:
    """Limit the memory of the process; MemoryLimitError with the name of the file if more is needed."""
    # Windows and macOS have no such limit: there only the checks before a job apply.
    with contextlib.ExitStack() as restored:
        if size is not None and sys.platform != "win32":
            import resource

            before, most = resource.getrlimit(resource.RLIMIT_DATA)
            restored.callback(resource.setrlimit, resource.RLIMIT_DATA, (before, most))
            wanted = size + _PROGRAM + _PER_PROCESSOR * (os.cpu_count() or 1)
            known = [limit for limit in (before, most) if limit != resource.RLIM_INFINITY]
            resource.setrlimit(resource.RLIMIT_DATA, (min([wanted, *known]), most))
        try:
            yield
        except (MemoryError, RuntimeError, ImportError) as error:
            # Python says no more where there is no memory for the stack of a thread, or for a library.
            if isinstance(error, RuntimeError) and str(error) != "can't start new thread":
                raise
            if isinstance(error, ImportError) and size is None:
                raise
            limit = "the memory of this machine" if size is None else f"{show_size(size)} of memory"
            remedy = "raise --max-memory, or give a smaller model"
            raise MemoryLimitError(name, f"needs more than {limit}", remedy) from error


@contextlib.contextmanager
def memory_reserved(size: int) -> Iterator[None]:
    """Lift the limit for a library that would crash at it; MemoryError unless the `size` bytes it takes are left."""
    if sys.platform == "win32":
        yield
        return
    import resource

    limit, most = resource.getrlimit(resource.RLIMIT_DATA)
    if limit == resource.RLIM_INFINITY:
        yield
        return
    bytearray(size)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    data = _status("VmData") or 0
    try:
        yield
    finally:
        # Memory beyond `size`, such as for its threads, counts as that of the program.
        raised = limit + max(0, (_status("VmData") or 0) - data - size)
        resource.setrlimit(
            resource.RLIMIT_DATA, (raised if most == resource.RLIM_INFINITY else min(raised, most), most)
        )


def peak_memory() -> int | None:
    """Return the peak resident size of this process in bytes; None where it is unknown."""
    if _STATUS.exists():
        # On Linux ru_maxrss also counts what the process that started this one held at that moment.
        return _status("VmHWM")
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _status(name: str) -> int | None:
    """Return a size in bytes from the Linux status file of this process; None if it is not there."""
    if not _STATUS.exists():
        return None
    fields = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines())
    return int(fields[name].split()[0]) * 1024 if name in fields else None
