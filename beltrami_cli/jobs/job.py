"""How a job is done, how far it is, and what time it takes; and the parameters of noise, new textures and comparisons.

The progress of a job is one share that never falls, and the time left. A job has phases, which it announces with the
seconds that each is expected to take as soon as it knows how many samples there are. These are seconds of all cores
together, so that neither their number nor other programs matter. Phases that say nothing while they work advance with
the time that the process computes. The expectation is corrected by the times that phases took.
Light enough to import anywhere.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Checked, amount, check, described, parameter, share_in, sure_amount
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.output import FileSet

Progress = Callable[[str, int, int], None]  # a label, the work done and the work to do

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
class Job:
    """How a job is done, besides its parameters.

    Attributes
    ----------
    access : Access
        What may be read, and how much memory may be used.
    progress : callable, optional
        Called with a label of the current part, the work done so far and the total work; may raise to stop.
    overwrite : bool
        Whether the output, and the sidecar files that it refers to, may be replaced.
    dry_run : bool
        Compute everything and write nothing.
    format : str or None
        Format to write, if the name of the output does not have its extension: "ply", "obj", "glb", "gltf", "png", ...
    files : FileSet or None
        Only for callers that write further files, such as a report, together with the output.
    check : callable, optional
        Only for callers that do more with the document: called with it before anything is computed; may raise.
    """

    access: Access = EVERYTHING_INSIDE
    progress: Progress | None = None
    overwrite: bool = False
    dry_run: bool = False
    format: str | None = None
    files: FileSet | None = None
    check: Callable[[Document], None] | None = None

    def expect(self, phases: Iterable[tuple[str, float]]) -> None:
        """Announce the phases ahead, and how many seconds each takes."""
        expect = getattr(self.progress, "expect", None)
        if expect is not None:
            expect(phases)

    def begin(self, label: str) -> None:
        """Report that a phase begins."""
        if self.progress is not None:
            self.progress(label, 0, 1)

    def progress_of(self, label: str) -> Callable[[int, int], None] | None:
        return None if self.progress is None else partial(self.progress, label)


PLAIN_JOB = Job()


class Stopwatch:
    """Adds up the time of named stages."""

    def __init__(self) -> None:
        # "wall" and "cpu" seconds (all threads of the process), in the order of their start.
        self.stages: dict[str, dict[str, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        wall, cpu = time.perf_counter(), time.process_time()
        times = self.stages.setdefault(name, {"wall": 0.0, "cpu": 0.0})
        try:
            yield
        finally:
            times["wall"] += time.perf_counter() - wall
            times["cpu"] += time.process_time() - cpu


def phases_of(kinds: Sequence[str], samples: int) -> list[tuple[str, float]]:
    """Return phases with the seconds that they are expected to take for a number of samples."""
    return [(kind, _SECONDS[kind][0] + 1e-6 * _SECONDS[kind][1] * samples) for kind in kinds]


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


def tracked(items: Sequence[Item], label: str, progress: Progress | None) -> Iterator[Item]:
    """Give items one after the other, and show how many of them are done."""
    for number, item in enumerate(items):
        if progress is not None:
            progress(label, number, len(items))
        yield item
    if progress is not None and items:
        progress(label, len(items), len(items))


def at_intervals(seconds: float, progress: Progress) -> Progress:
    """Return a progress that drops what comes less than some seconds after what it passed on last."""
    last = 0.0

    def update(label: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= seconds:
            last = time.monotonic()
            progress(label, done, total)

    return update


_SMALLEST_SIDE, _LARGEST_SIDE = 16, 16384  # of a texture: less is of no use, graphics cards take no more

Kind = Literal["gaussian", "salt-pepper", "speckle", "poisson", "white", "camera", "grain", "jpeg"]
_WITHOUT_SIGMA = ("camera", "jpeg")
_OF_ONE_KIND = {"shot": "camera", "read": "camera", "size": "grain", "quality": "jpeg"}


@dataclass(frozen=True)
class NoiseSettings(Checked):
    """What noise is added; UsageError if a value is out of its range."""

    group: ClassVar[str] = "Noise"

    sigma: float | None = parameter(
        None,
        "How much, of full scale: 20 is 20/255, as `beltrami info` shows noise; or as 20/255, 1310/65535 or "
        "8%. Needed by all kinds but camera and jpeg.",
        kind=float, low=0, high=1, unit="shares of full scale", metavar="S", parse=sure_amount, is_daily=True,
    )  # fmt: skip
    kind: Kind = parameter(
        "gaussian",
        "Of the same deviation everywhere (white is the same); black and white samples; in proportion to the "
        "colour; to its square root; as a camera makes it; shared by neighbours; or as JPEG makes it.",
        choices=get_args(Kind), is_daily=True,
    )  # fmt: skip
    seed: int = parameter(
        0, "The same seed gives the same noise, for any number of threads.", low=0, metavar="K", is_daily=True
    )
    shot: float = parameter(
        0.01, "Of a camera: A of the variance A L + B^2 of the light L, which is linear, 0 to 1.",
        low=0, high=1, metavar="A", is_daily=True,
    )  # fmt: skip
    read: float = parameter(
        0.005, "Of a camera: B of that variance, the deviation in the dark.",
        low=0, high=1, metavar="B", is_daily=True,
    )  # fmt: skip
    size: float = parameter(
        2.0, "Of grain: how far neighbours share it; from this distance on they hardly do.",
        low=1, high=64, unit="distances of samples", metavar="N", is_daily=True,
    )  # fmt: skip
    quality: int = parameter(
        85, "Of jpeg: the quality at which each picture is coded, with colour at half the resolution (4:2:0).",
        low=1, high=100, metavar="Q", is_daily=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sigma is None and self.kind not in _WITHOUT_SIGMA:
            raise UsageError(f"--sigma says how much {self.kind} noise is added, such as --sigma 20; give it")
        for name, kind in _OF_ONE_KIND.items():
            if kind != self.kind and getattr(self, name) != getattr(type(self), name):
                raise UsageError(f"--{name} is of {kind} noise, not of {self.kind}; add --kind {kind}")

    @property
    def deviation(self) -> float:
        """`sigma`, or 0 where it means nothing."""
        return 0.0 if self.sigma is None else self.sigma


@described
@dataclass(frozen=True)
class BakeSettings:
    """How a new texture is made."""

    group: ClassVar[str] = "New textures"

    size: int | None = parameter(
        None, "Longest side of the new texture.", kind=int, low=_SMALLEST_SIDE, high=_LARGEST_SIDE, unit="texels",
        unset="two texels along an edge, at most 8192; or as in the old texture", metavar="N",
    )  # fmt: skip
    padding: int = parameter(
        4, "Distance between the charts of a new texture.", low=0, high=64, unit="texels", metavar="N"
    )
    keep_uv: bool = parameter(False, "Use the texture coordinates of INPUT rather than make new ones.")
    max_unwrap_faces: int = parameter(
        100_000,
        "The largest mesh to unwrap: 16 thousand triangles take some 7 s, 82 thousand 2 minutes, as the "
        "time grows faster than their number.",
        low=1, unit="triangles", metavar="COUNT", lifts_limit=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)
        if self.size is not None and self.size <= 4 * self.padding:
            raise UsageError(f"a size of {self.size} leaves no room between paddings of {self.padding}")


@dataclass(frozen=True)
class Limits(Checked):
    """What a comparison must keep to; None: anything goes. UsageError if nothing could keep to it."""

    group: ClassVar[str] = "Limits"

    min_psnr: float | None = parameter(
        None, "Lowest PSNR allowed.", kind=float, unit="dB", metavar="DB", is_daily=True
    )
    min_ssim: float | None = parameter(
        None, "Lowest structural similarity allowed; 1 is equal.",
        kind=float, high=1, metavar="S", is_daily=True,
    )  # fmt: skip
    max_delta_e: float | None = parameter(
        None, "Largest mean Delta E 2000 allowed.", kind=float, low=0, metavar="E", is_daily=True
    )
    max_seam_jump: float | None = parameter(
        None,
        "How much larger the mean colour step over seams may be than in REFERENCE: 1 is 1/255; or as 1/255 "
        "or 0.4%.",
        kind=float, metavar="X", parse=amount, is_daily=True,
    )  # fmt: skip
    max_move: float | None = parameter(
        None,
        "How far a vertex may be from its place in REFERENCE, such as 0.1%. With other limits alone, it may "
        "not move by more than rounding.",
        kind=float, low=0, unit="longest sides of the model", metavar="SHARE", parse=share_in,
    )  # fmt: skip
