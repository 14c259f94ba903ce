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
_UNANNOUNCED = 1.0  # seconds of a phase that no job has announced; more is left then than has been done
_FIRST_SHARE = 0.05  # of the whole, that a first phase takes while nothing is announced
_TRUSTED = 0.1  # share of a phase after which its time left is extrapolated from its own speed
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
    """A progress callback that joins the phases of a job to one share of the whole."""

    # Whose seconds phases take; of a process that waits for others, the time of day.
    clock: Callable[[], float] = time.process_time
    _start_times: tuple[float, float] = (0.0, 0.0)  # of `clock` and the time of day
    _ahead: list[tuple[str, float]] = field(
        default_factory=list
    )  # phases to come, and their expected seconds
    _is_announced: bool = False
    _is_timed: bool = False  # whether the announced seconds are more than shares
    _label: str = ""
    _is_begun: bool = False
    _first: float = 0.0  # share of the whole when the current phase began
    _last: float = 0.0  # largest share that was shown
    _expected: float = 0.0  # seconds of the current phase
    _began: float = 0.0  # when it did
    _heard: tuple[float, float] = (0.0, 0.0)  # its share that it last reported, and when
    _base: float = 0.0  # its share that was shown then
    _times: tuple[float, float] = (0.0, 0.0)  # seconds that the phases before took, and were expected to take
    _lock: Any = field(default_factory=threading.RLock, repr=False)  # a terminal is drawn by another thread

    def __post_init__(self) -> None:
        self._start_times = self.clock(), time.monotonic()

    def expect(self, phases: Iterable[tuple[str, float]], *, timed: bool = True) -> None:
        """End the current phase, and announce the next, with their seconds, or only their ratios if not `timed`."""
        with self._lock:
            self._first, self._expected, self._is_begun = self.state().share, 0.0, False
            self._ahead, self._is_announced, self._is_timed = list(phases), True, timed

    def __call__(self, label: str, done: int, total: int) -> None:
        """Report work of a phase; one with another label than before ends that."""
        now = self.clock()
        with self._lock:
            if not self._is_begun or _COUNT.sub("", label) != _COUNT.sub("", self._label):
                self._start(label, now)
            self._label, self._is_begun = label, True
            share = max(self._heard[0], min(1.0, done / max(1, total)))
            self._base, self._heard = max(share, self._reached(now)), (share, now)

    def _start(self, label: str, now: float) -> None:
        if self._is_begun:
            self._times = self._times[0] + now - self._began, self._times[1] + self._expected
            self._first = self._at(1.0)
        kind = _COUNT.sub("", label).rpartition(": ")[2]
        known = [number for number, (name, _) in enumerate(self._ahead) if name == kind]
        self._expected = _UNANNOUNCED
        if known:
            self._expected = self._ahead[known[0]][1]
            del self._ahead[: known[0] + 1]
        self._began, self._base, self._heard = now, 0.0, (0.0, now)

    def _at(self, share: float) -> float:
        """Return the share of the whole at a share of the current phase."""
        ahead = sum(seconds for _, seconds in self._ahead)
        if not self._is_announced:
            ahead = self._expected * (1 / _FIRST_SHARE - 1)
        whole = self._expected + ahead
        return self._first + (1 - self._first) * share * (self._expected / whole if whole else 1.0)

    def _slowness(self) -> float:
        """Return how many times longer phases take than was expected."""
        (taken, expected), (heard, when) = self._times, self._heard
        if heard >= _TRUSTED:
            taken, expected = taken + when - self._began, expected + self._expected * heard
        return (_PRIOR + taken) / (_PRIOR + expected)

    def _left(self) -> float:
        """Return the seconds that the current phase had left when it was heard of last."""
        heard, when = self._heard
        if heard >= _TRUSTED:
            return (when - self._began) * (1 - heard) / heard
        return self._expected * self._slowness() * (1 - heard)

    def _reached(self, now: float) -> float:
        """Return the share of the current phase that is shown: without news it comes ever closer to its end."""
        left = self._left()
        waited = (now - self._heard[1]) / left if left > 0 else 0.0
        return 1 - (1 - self._base) * math.exp(-waited)

    def state(self) -> State:
        now = self.clock()
        with self._lock:
            self._last = min(1.0, max(self._last, self._at(self._reached(now))))
            ahead = self._slowness() * sum(seconds for _, seconds in self._ahead)
            rest = max(self._left() - (now - self._heard[1]), 0.0) + ahead
            computed, passed = now - self._start_times[0], time.monotonic() - self._start_times[1]
            is_known = computed >= _LEAST_TIME and (self._is_timed or self._heard[0] >= _TRUSTED)
            return State(self._label, self._last, rest * passed / computed if is_known else None)


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

    def show(number: int, share: float) -> None:
        if progress is not None:
            progress(
                f"{min(number + 1, count)} of {count} {noun}",
                round(_STEPS * (number + share)),
                _STEPS * count,
            )

    def forward(number: int, _: str, share: float) -> None:
        show(number, share)

    for number, item in enumerate(items):
        show(number, 0.0)
        yield item, None if progress is None else Share(forward=partial(forward, number))
    show(count, 0.0)


def phases_of(kinds: Sequence[str], samples: int) -> list[tuple[str, float]]:
    """Return phases with the seconds that they are expected to take for a number of samples."""
    return [(kind, _SECONDS[kind][0] + 1e-6 * _SECONDS[kind][1] * samples) for kind in kinds]
