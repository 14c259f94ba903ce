"""How a job is done: what it may read and write, how it reports progress, and what memory and time it takes.

Also the parameters of added noise and of new textures, and the limits of comparisons. Light enough to import anywhere.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, TypeVar, get_args

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import Checked, check, described, number_in, parameter, share_in, show_size
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.output import FileSet


Progress = Callable[[str, int, int], None]  # a label, the work done and the work to do

Item = TypeVar("Item")


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
        """Announce the phases ahead, and how many seconds each takes, see `jobs/progress.py`."""
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

_UNLIMITED: ContextVar[int | None] = ContextVar("unlimited", default=None)
"""The limit of the process before `limited_memory` set its own, in bytes as the system counts them."""

_LEAST = 1 << 26  # bytes that a command takes in any case
_STATUS = Path("/proc/self/status")
_MEMORY, _OWN_CGROUPS, _CGROUPS = Path("/proc/meminfo"), Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
# What the program itself takes: libraries, and for each processor the stacks of its threads.
_PROGRAM, _PER_PROCESSOR = 160 << 20, 24 << 20


def default_memory() -> int | None:
    """Return half of the bytes that are available to this process now; None if they are unknown."""
    known = [size for size in (_available(), *_left_in_cgroups()) if size is not None]
    return max(min(known) // 2, _LEAST) if known else None


def _available() -> int | None:
    """Return what the system can give without swapping, or else what it has."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in _MEMORY.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    with contextlib.suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _left_in_cgroups() -> Iterator[int]:
    """Give the remaining memory under each cgroup limit of this process, of both cgroup versions."""
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
        own = root / path.strip("/")
        for folder in (own, *own.parents):
            if folder.is_relative_to(root):
                with contextlib.suppress(OSError, ValueError):  # "max" is no limit
                    limit = int((folder / most).read_text())
                    yield max(limit - int((folder / current).read_text()) + _cached(folder), 0)


def _cached(folder: Path) -> int:
    """Return the bytes of files that a cgroup holds in memory, which are given up when they are needed."""
    with contextlib.suppress(OSError, ValueError):
        fields = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
        return int(fields.get("inactive_file", 0)) + int(fields.get("active_file", 0))
    return 0


@contextmanager
def limited_memory(size: int | None, name: str) -> Iterator[None]:
    """Limit the memory of the process in this context; InputError with the name of the file if more is needed."""
    # Windows and macOS have no such limit: there only the checks before a job apply.
    with contextlib.ExitStack() as restored:
        if size is not None and sys.platform != "win32":
            import resource

            before, most = resource.getrlimit(resource.RLIMIT_DATA)
            restored.callback(resource.setrlimit, resource.RLIMIT_DATA, (before, most))
            wanted = size + _PROGRAM + _PER_PROCESSOR * (os.cpu_count() or 1)
            known = [limit for limit in (before, most) if limit != resource.RLIM_INFINITY]
            resource.setrlimit(resource.RLIMIT_DATA, (min([wanted, *known]), most))
            restored.callback(_UNLIMITED.reset, _UNLIMITED.set(before))
        try:
            yield
        except MemoryError as error:
            limit = "the memory of this machine" if size is None else f"{show_size(size)} of memory"
            remedy = "raise --max-memory, or give a smaller model"
            raise InputError(name, f"needs more than {limit}", remedy) from error


@contextlib.contextmanager
def memory_reserved(size: int) -> Iterator[None]:
    """Lift the limit for a library that crashes at it, and takes `size` bytes; MemoryError if there are none left."""
    before = _UNLIMITED.get()
    if before is None:
        yield
        return
    import resource

    bytearray(size)
    limit, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (before, most))
    data = _status("VmData") or 0
    try:
        yield
    finally:
        # What it takes besides, for its threads, counts as memory of the program.
        raised = limit + max(0, (_status("VmData") or 0) - data - size)
        resource.setrlimit(
            resource.RLIMIT_DATA, (raised if most == resource.RLIM_INFINITY else min(raised, most), most)
        )


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


def peak_memory() -> int | None:
    """Return the largest resident size of this process so far, in bytes, or None where it is not known."""
    if _STATUS.exists():
        # On Linux ru_maxrss also counts what the process that started this one held at that moment.
        return _status("VmHWM")
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _status(name: str) -> int | None:
    """Return the bytes that Linux counts of this process under a name; None if it does not."""
    if not _STATUS.exists():
        return None
    fields = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines())
    return int(fields[name].split()[0]) * 1024 if name in fields else None


_SMALLEST_SIDE, _LARGEST_SIDE = 16, 16384  # of a texture: less is of no use, graphics cards take no more

Kind = Literal["gaussian", "salt-pepper", "speckle", "poisson", "white", "camera", "grain", "jpeg"]
_WITHOUT_SIGMA = ("camera", "jpeg")


def amount(text: str) -> float:
    """Read a part of full scale: 20 is 20/255, and 20/255, 1310/65535 and 8% are what they say; or ValueError."""
    try:
        value, is_plain = number_in(text)
    except ValueError:
        raise ValueError(f"is {text!r}, but must be an amount such as 20 (of 255), 20/255 or 8%") from None
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"is {text!r}, but must be a number from 0 on")
    return value / 255 if is_plain else value


def sure_amount(text: str) -> float:
    """Read it, but refuse plain numbers between 0 and 1, which may be of 255 or of 1."""
    value = amount(text)
    if value > 1:
        raise ValueError(f"is {text.strip()}, but must be at most 255 (of 255), or 100%")
    if 0 < value < 1 / 255 and not set(text) & set("/%"):
        number = text.strip()
        remedy = f"write {number}/255 or {100 * float(number):g}%"
        raise ValueError(f"is {number}, which may be of 255 or of full scale; {remedy}")
    return value


@dataclass(frozen=True)
class NoiseSettings(Checked):
    """What noise is added; UsageError if a value is out of its range."""

    group: ClassVar[str] = "Noise"

    sigma: float | None = parameter(
        None,
        "How much, of full scale: 20 is 20/255, as `beltrami info` shows noise; or as 20/255, 1310/65535 or "
        "8%. Needed by all kinds but camera and jpeg.",
        kind=float, low=0, high=1, metavar="S", parse=sure_amount, is_daily=True,
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
