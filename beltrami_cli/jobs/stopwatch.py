"""Time per stage, and peak memory."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


class Stopwatch:
    """Adds up the time of named stages.

    Attributes
    ----------
    stages : dict of str to dict
        For each stage its "wall" and "cpu" seconds (all threads of the process), in the order of their start.
    """

    def __init__(self) -> None:
        self.stages: dict[str, dict[str, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what runs in the context as the stage `name`."""
        wall, cpu = time.perf_counter(), time.process_time()
        times = self.stages.setdefault(name, {"wall": 0.0, "cpu": 0.0})
        try:
            yield
        finally:
            times["wall"] += time.perf_counter() - wall
            times["cpu"] += time.process_time() - cpu


def peak_memory() -> int | None:
    """Return the largest resident size of this process so far, in bytes, or None where it is not known."""
    status = Path("/proc/self/status")
    if status.exists():
        # On Linux ru_maxrss also counts what the process that started this one held at that moment.
        fields = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return int(fields["VmHWM"].split()[0]) * 1024 if "VmHWM" in fields else None
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
