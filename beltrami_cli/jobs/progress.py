"""How far a job is, as one share that never falls, and the time left.

A job has phases, which it announces with the seconds that each is expected to take as soon as it knows how many
samples there are. These are seconds of all cores together, so that neither their number nor other programs matter.
Phases that say nothing while they work advance with the time that the process computes. The expectation is corrected by
the times that phases took.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

from beltrami_cli.jobs.job import Progress

Item = TypeVar("Item")

# Seconds of processor time that a phase takes in any case, and microseconds per texel, as
# `python benchmarks/bench_progress.py` measures them on a small and a large texture.
_SECONDS = {
    "laying out": (0.02, 0.15),
    "choosing parameters": (1.0, 0.45),
    "smoothing": (0.05, 2.0),
    "painting": (0.02, 0.3),
    "writing": (0.02, 0.05),
    "comparing": (0.02, 0.2),
    "measuring": (0.02, 0.45),
    "counting changes": (0.01, 0.05),
    "drawing seams": (0.01, 0.01),
    "packing models": (0.1, 0.5),
}
_COUNT = re.compile(r"\d+ of \d+ ")  # before a label: shown, but no part of its name
_EXPECTED = 1.0  # seconds of a phase that no job has announced
_UNANNOUNCED = 19.0  # seconds that follow it: it takes a twentieth of the whole
_TRUSTED = 0.1  # share of a phase after which its own speed counts
_STEPS = 1000  # of the work on one of several items
_PRIOR = 1.0  # seconds by which expectations count against the times that phases took
_LEAST_TIME = 0.3  # seconds of processor time after which the load of the machine is known well enough


@dataclass(frozen=True)
class State:
    """How far a job is now."""

    label: str = ""
    share: float = 0.0
    seconds_left: float | None = None  # None: not known yet


@dataclass
class Work:
    """A progress callback that joins the phases of a job to one share of the whole.

    Without news the share comes ever closer to 1, at the pace of the seconds that are left.
    """

    # Whose seconds phases take; of a process that waits for others, the time of day.
    clock: Callable[[], float] = time.process_time
    _start_times: tuple[float, float] = (0.0, 0.0)  # of `clock` and the time of day
    _ahead: list[tuple[str, float]] = field(
        default_factory=list
    )  # phases to come, and their expected seconds
    _unannounced: float = _UNANNOUNCED  # expected seconds of what no job has announced
    _is_timed: bool = False  # whether the announced seconds are more than shares
    _label: str | None = None  # of the current phase
    _began: float = 0.0  # when it did
    _expected: float = 0.0  # its seconds
    _share: float = 0.0  # of it that is done
    _times: tuple[float, float] = (0.0, 0.0)  # seconds that the phases before took, and were expected to take
    _first: tuple[float, float] = (
        0.0,
        1.0,
    )  # share of the whole when it began, and the expected seconds left then
    _shown: tuple[float, float, float] = (
        0.0,
        0.0,
        0.0,
    )  # share of the whole, when, and the seconds left then
    _lock: Any = field(default_factory=threading.RLock, repr=False)  # a terminal is drawn by another thread

    def __post_init__(self) -> None:
        self._start_times = self.clock(), time.monotonic()

    def expect(self, phases: Iterable[tuple[str, float]], *, timed: bool = True) -> None:
        """End the current phase, and announce the next, with their seconds, or only their ratios if not `timed`."""
        with self._lock:
            self._ahead, self._unannounced, self._is_timed, self._label = list(phases), 0.0, timed, None

    def __call__(self, label: str, done: int, total: int) -> None:
        """Report work of a phase; one with another label than before ends that."""
        now = self.clock()
        with self._lock:
            shown = self.state().share
            if self._label is None or _COUNT.sub("", label) != _COUNT.sub("", self._label):
                self._start(label, now, shown)
            self._label = label
            self._share = max(self._share, min(1.0, done / max(1, total)))
            first, whole = self._first
            share = first + (1 - first) * (1 - self._left() / whole if whole else 1.0)
            taken, expected = self._times
            if self._share >= _TRUSTED:
                taken, expected = taken + now - self._began, expected + self._expected * self._share
            slowness = (_PRIOR + taken) / (_PRIOR + expected)
            self._shown = max(shown, share), now, slowness * self._left()

    def _start(self, label: str, now: float, shown: float) -> None:
        if self._label is not None:
            self._times = self._times[0] + now - self._began, self._times[1] + self._expected
        kind = _COUNT.sub("", label).rpartition(": ")[2]
        known = [number for number, (name, _) in enumerate(self._ahead) if name == kind]
        self._expected = self._ahead[known[0]][1] if known else _EXPECTED
        if known:
            del self._ahead[: known[0] + 1]
        self._began, self._share = now, 0.0
        self._first = shown, self._left()

    def _left(self) -> float:
        """Return the expected seconds of all that is left."""
        ahead = sum(seconds for _, seconds in self._ahead)
        return self._expected * (1 - self._share) + ahead + self._unannounced

    def state(self) -> State:
        now = self.clock()
        with self._lock:
            share, when, left = self._shown
            share = 1 - (1 - share) * math.exp((when - now) / left) if left > 0 else share
            computed, passed = now - self._start_times[0], time.monotonic() - self._start_times[1]
            is_known = computed >= _LEAST_TIME and (self._is_timed or self._share >= _TRUSTED)
            rest = max(left - (now - when), 0.0)
            return State(self._label or "", share, rest * passed / computed if is_known else None)


@dataclass
class Share(Work):
    """Progress of a part of a job; `forward` is called with a label and the share of the part."""

    forward: Callable[[str, float], None] = lambda label, share: None

    def __call__(self, label: str, done: int, total: int) -> None:
        super().__call__(label, done, total)
        self.forward(label, self.state().share)


def one_of(
    items: Sequence[Item], noun: str, progress: Progress | None
) -> Iterator[tuple[Item, Progress | None]]:
    """Give items one after the other, each with the progress of the work on it."""
    count = len(items)
    if isinstance(progress, Work):
        progress.expect([(noun, float(count))], timed=False)

    def show(number: int, _: str, share: float) -> None:
        if progress is not None:
            label = f"{min(number + 1, count)} of {count} {noun}"
            progress(label, round(_STEPS * (number + share)), _STEPS * count)

    for number, item in enumerate(items):
        show(number, "", 0.0)
        yield item, None if progress is None else Share(forward=partial(show, number))
    show(count, "", 0.0)


def phases_of(kinds: Sequence[str], samples: int) -> list[tuple[str, float]]:
    """Return phases with the seconds that they are expected to take for a number of samples."""
    return [(kind, _SECONDS[kind][0] + 1e-6 * _SECONDS[kind][1] * samples) for kind in kinds]
