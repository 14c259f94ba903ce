"""The progress of a job as one fraction of the whole, which never decreases.

A job has phases, which it announces with the seconds that each is expected to take as soon as it knows how many samples
there are. These are seconds of all cores together, so that neither their number nor other programs matter. Phases that
report nothing while they work advance with the time that the process computes. Light enough to import anywhere.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self, TypeVar

Progress = Callable[[str, float, float], None]  # a label, the work done and the whole work
PhaseProgress = Callable[[int, int], None]  # of one phase: the work done and the whole work
Expected = tuple[str, float]  # a phase, and the seconds that it is expected to take
Item = TypeVar("Item")
# Seconds of processor time that a phase takes in any case, and microseconds per texel, as
# `python benchmarks/bench_progress.py` measures them on a small and a large texture.
_SECONDS = {
    "laying out": (0.02, 0.15),
    "choosing parameters": (1.0, 0.45),
    "smoothing": (0.05, 2.0),
    "recolouring": (0.02, 0.3),
    "writing": (0.02, 0.05),
    "comparing": (0.02, 0.2),
    "measuring": (0.02, 0.45),
    "counting changes": (0.01, 0.05),
    "drawing seams": (0.01, 0.01),
    "packing models": (0.1, 0.5),
}
_UNANNOUNCED_PHASE = 1.0  # seconds of a phase that no job has announced
_UNANNOUNCED_REST = 19.0  # seconds that follow it: it takes a twentieth of the whole
_PRIOR = 1.0  # seconds by which expectations count against the times that phases took
_INTERVAL = 0.1  # seconds between two messages on progress


class Label(str):
    """A label of a phase with details, and the name of the phase."""

    phase: str

    def __new__(cls, text: str, phase: str = "") -> Self:
        label = super().__new__(cls, text)
        label.phase = phase
        return label


def phase_of(label: str) -> str:
    """Return the phase of a label; a label that is not a `Label` is the name of the phase."""
    return label.phase if isinstance(label, Label) else label


def phases_of(kinds: Sequence[str], samples: int) -> list[Expected]:
    """Return phases with the seconds that they are expected to take for a number of samples."""
    return [(kind, _SECONDS[kind][0] + 1e-6 * _SECONDS[kind][1] * samples) for kind in kinds]


@dataclass(frozen=True)
class _Phase:
    """The current phase."""

    name: str
    seconds: float  # that it is expected to take
    start_share: float  # of the whole, when it began
    start_seconds: float  # left when it began
    done: float = 0.0  # fraction of it


@dataclass(frozen=True)
class _Report:
    """A report as it was made."""

    share: float  # of the whole
    seconds: float  # left
    at: float


class Work:
    """A progress callback that combines the phases of a job into one fraction of the whole.

    Between reports the share comes ever closer to 1, at the pace of the seconds that are left.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # a terminal is drawn by another thread
        self._label = ""
        self._phase: _Phase | None = None
        self._coming = list[Expected]()  # announced phases
        self._unannounced = _UNANNOUNCED_REST  # expected seconds of unannounced phases
        self._announced_at, self._announced_seconds = time.process_time(), _UNANNOUNCED_REST  # left then
        self._last = _Report(share=0.0, seconds=0.0, at=0.0)

    def expect(self, phases: Iterable[Expected]) -> None:
        """End the current phase, and announce the next; where no times are known, seconds may be any unit."""
        with self._lock:
            self._coming, self._unannounced = list(phases), 0.0
            self._label, self._phase = "", None
            self._announced_at, self._announced_seconds = time.process_time(), self._seconds_left()

    def __call__(self, label: str, done: float, total: float) -> None:
        """Report work of a phase; a new phase ends the previous one."""
        with self._lock:
            shown, phase = self.share(), self._phase
            if phase is None or phase.name != phase_of(label):
                phase = self._begun(phase_of(label), shown)
            self._label = label
            self._phase = replace(phase, done=max(phase.done, min(1.0, done / max(1.0, total))))
            left = self._seconds_left()
            progress = 1 - left / phase.start_seconds if phase.start_seconds else 1.0
            share = max(shown, phase.start_share + (1 - phase.start_share) * progress)
            now = time.process_time()
            expected = max(0.0, self._announced_seconds - left)
            slowness = (_PRIOR + now - self._announced_at) / (_PRIOR + expected)
            self._last = _Report(share, slowness * left, now)

    def _begun(self, name: str, share: float) -> _Phase:
        """Return a phase that begins, and drop it from the announced ones with those before it."""
        names, seconds = [name for name, _ in self._coming], _UNANNOUNCED_PHASE
        if name in names:
            number = names.index(name)
            seconds = self._coming[number][1]
            del self._coming[: number + 1]
        self._phase = None
        return _Phase(name, seconds, share, seconds + self._seconds_left())

    def _seconds_left(self) -> float:
        now = 0.0 if self._phase is None else self._phase.seconds * (1 - self._phase.done)
        return now + sum(seconds for _, seconds in self._coming) + self._unannounced

    @property
    def label(self) -> str:
        return self._label

    def share(self) -> float:
        with self._lock:
            left, since = self._last.seconds, time.process_time() - self._last.at
            return 1 - (1 - self._last.share) * left / (left + since) if left > 0 else self._last.share


class Share(Work):
    """Progress of a part of a job; `forward` is called with a label, the completed fraction of the part, and 1."""

    def __init__(self, forward: Progress) -> None:
        super().__init__()
        self._forward = forward

    def __call__(self, label: str, done: float, total: float) -> None:
        super().__call__(label, done, total)
        self._forward(label, self.share(), 1.0)


def each_with_progress(
    items: Sequence[Item], noun: str, progress: Progress | None
) -> Iterator[tuple[Item, Progress | None]]:
    """Yield items, each with a progress callback for the work on it."""
    count = len(items)
    if isinstance(progress, Work):
        progress.expect([(noun, float(count))])

    def show(number: int, _label: str = "", done: float = 0.0, total: float = 1.0) -> None:
        if progress is not None:
            label = Label(f"{min(number + 1, count)} of {count} {noun}", noun)
            progress(label, number + done / total, count)

    for number, item in enumerate(items):
        show(number)
        yield item, None if progress is None else Share(forward=partial(show, number))
    show(count)


def tracked(items: Sequence[Item], label: str, progress: Progress | None) -> Iterator[Item]:
    """Yield items, and report how many of them are done."""
    for number, item in enumerate(items):
        if progress is not None:
            progress(label, number, len(items))
        yield item
    if progress is not None and items:
        progress(label, len(items), len(items))


def at_intervals(progress: Progress, seconds: float = _INTERVAL) -> Progress:
    """Return a progress callback that forwards at most one report per some seconds."""
    last = 0.0

    def update(label: str, done: float, total: float) -> None:
        nonlocal last
        if time.monotonic() - last >= seconds:
            last = time.monotonic()
            progress(label, done, total)

    return update
