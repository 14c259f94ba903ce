"""Parameters of the short-time kernel: defaults, limits and consequences."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Checked, described, parameter
from beltrami_cli.flow.given_noise import GivenNoise, file_of_noise

Weights = Literal["uniform", "area"]
Units = Literal["spacing", "world"]
Scheme = Literal["triangles", "metric"]
Space = Literal["srgb", "linear", "oklab", "data"]
Clipping = Literal["restore", "keep"]
Solver = Literal["auto", "fast-marching", "segments"]
Patches = Literal["auto", "on", "off"]
OnOutliers = Literal["auto", "replace", "keep"]
Tunable = Literal["iterations", "t", "beta", "beta_growth", "metric_steps"]

# The parameters that can be chosen from the data.
TUNABLE: tuple[Tunable, ...] = get_args(Tunable)

# Weight of smoothness against fidelity to the input. Numbers are interpolated between these.
STRENGTHS = {"gentle": 0.7, "normal": 1.0, "strong": 1.5}

_STRENGTH_RANGE = "{}, or a number between {gentle} and {strong}".format(", ".join(STRENGTHS), **STRENGTHS)

# The error of distances along segments stays the same on ever finer meshes, that of fast marching shrinks: on level
# lattices both are 2.5 per cent at this radius, in sample spacings. On noisy colours segments are better at any.
_SEGMENTS_REACH = 14

# A Gaussian of a smaller standard deviation, in sample spacings, has no weight beyond its own sample.
_SMALLEST_SCALE = 0.05

_CHOSEN_FROM_DATA = "chosen from the data, else {default}"

# With the default time step this is a Gaussian of 219 sample spacings, sqrt(2 n t): wider than any noise.
MAX_ITERATIONS = 10_000

# Logarithm of the growth at which any difference in colour is far beyond the kernel, and numbers do not overflow yet.
_MAX_GROWTH = 25.0


def _strength_in(text: str) -> float:
    try:
        return STRENGTHS[text] if text in STRENGTHS else float(text)
    except ValueError:
        raise ValueError(f"is {text!r}, but must be {_STRENGTH_RANGE}") from None


def _strength_shown(value: float) -> str:
    return next((name for name, weight in STRENGTHS.items() if weight == value), f"{value:g}")


@described
@dataclass(frozen=True)
class KernelParameters(Checked):
    """Parameters of the smoothing kernel, with those of noise and patches."""

    group: ClassVar[str] = "Kernel"

    strength: float = parameter(
        STRENGTHS["normal"],
        "Smooth less or more: gentle assumes the least noise that is likely, strong the most. "
        "Options that are given are kept.",
        low=STRENGTHS["gentle"], high=STRENGTHS["strong"], allowed=_STRENGTH_RANGE, metavar="S",
        parse=_strength_in, show=_strength_shown, words=tuple(STRENGTHS), is_daily=True,
    )  # fmt: skip
    noise: str | None = parameter(
        None,
        "The noise if it is known: 12 (of 255), 4.7%, a FILE with a value for each sample, or shot:A,read:B of a "
        "camera (variance A L + B^2 at light L). Of a JPEG file, give the noise before compression; messages state "
        "how much of it is left. For frame:FILE and attribute:NAME see beltrami docs tuning.",
        kind=str, unset="estimated", metavar="S|FILE", is_daily=True, file_in=file_of_noise,
    )  # fmt: skip
    fast: bool = parameter(
        False,
        "Search nothing: parameters that are not given follow a fixed rule for the noise. It takes no "
        "time, and results are some 0.2 dB worse on vertices, and 1.1 dB on textures and images. --beta 0, "
        "--preset and --smooth-geometry search nothing either.",
        is_daily=True,
    )  # fmt: skip
    iterations: int = parameter(
        5,
        "Kernel iterations; more smooth further. 0 leaves every byte unchanged.",
        low=0, high=MAX_ITERATIONS, unset=_CHOSEN_FROM_DATA, flags=("-n", "--iterations"), metavar="N", is_daily=True,
    )  # fmt: skip
    t: float = parameter(
        2.4,
        "Time step of an iteration: away from edges, a Gaussian of variance 2T. On "
        "textures and images the window bounds the kernel, so that it is this Gaussian only if the window "
        "holds it: raise --window for a large T.",
        low=0, is_open=True, unit="squared units of length, see --units", unset=_CHOSEN_FROM_DATA,
        flags=("-t", "--time-step", "t"), metavar="T", is_daily=True,
    )  # fmt: skip
    beta: float | None = parameter(
        None,
        "How strongly edges are kept: 5 to 40 suits strong to slight noise, 0 is a plain Gaussian on the surface. "
        "Full scale of colour is 1.",
        kind=float, low=0, unit="units of length per unit of colour", unset="chosen from the data", metavar="B",
        is_daily=True,
    )  # fmt: skip
    beta_growth: float = parameter(
        2.0,
        "Multiply beta by G from one iteration to the next: as less noise is left, finer edges count.",
        low=1, high=100, unset=_CHOSEN_FROM_DATA, metavar="G",
    )  # fmt: skip
    threshold: float = parameter(
        0.01,
        "Leave out samples whose kernel value is below K.",
        low=0, high=1, is_open=True, metavar="K",
    )  # fmt: skip
    weights: Weights = parameter(
        "uniform",
        "Count each sample once, or by the surface area that it stands for. Textures and images are always "
        "smoothed with uniform weights.",
        choices=get_args(Weights), of=("vertex colours",),
    )  # fmt: skip
    units: Units = parameter(
        "spacing",
        "Unit of length of -t and --beta: the local sample spacing, or that of the file, which needs -t. On "
        "images, with or without --height, it is the pixel.",
        choices=get_args(Units),
    )  # fmt: skip
    max_samples: int = parameter(
        2000,
        "On vertices: the largest kernel, a guard against a time step that is too large. Warns when it "
        "takes effect. The default is lowered where very many triangles meet at a vertex or form no surface.",
        low=1, high=2**31 - 1, unit="samples", metavar="COUNT", of=("vertex colours",),
    )  # fmt: skip
    threads: int | None = parameter(
        None,
        "Threads; the result does not depend on it.",
        kind=int, low=1, high=1024, unset="all processors", metavar="COUNT",
    )  # fmt: skip
    window: int = parameter(
        7,
        "On textures and images: side of the square in which a kernel is looked for. Above 15 it takes much "
        "longer, since a heap march takes the place of vectorised sweeps.",
        low=3, high=255, is_odd=True, unit="samples", metavar="W", of=("textures", "images"),
    )  # fmt: skip
    metric_scale: float = parameter(
        0.5,
        "Measure distances in colours smoothed by a Gaussian of this standard deviation, so that noise "
        "does not create distances; averages are of the unsmoothed colours. 0: never.",
        low=_SMALLEST_SCALE, high=3, also=(0,), unit="sample spacings", metavar="S",
    )  # fmt: skip
    metric_steps: int = parameter(
        2,
        "Measure distances in smoothed colours in the first K iterations, and in unsmoothed ones in the "
        "others.",
        low=0, high=MAX_ITERATIONS, unset=_CHOSEN_FROM_DATA, metavar="K",
    )  # fmt: skip
    scheme: Scheme = parameter(
        "triangles",
        "On textures and images: distances through the triangles of neighbouring samples; or the paper's, "
        "by a heap march over the quadrants of the grid with the metric from central differences, obtuse "
        "ones split by it.",
        choices=get_args(Scheme), flags=(),
    )  # fmt: skip
    clipping: Clipping = parameter(
        "restore",
        "Where noise was clipped at 0 or full scale, averages are too bright or too dark: correct them, or "
        "keep them. A --beta of 0 always keeps them.",
        choices=get_args(Clipping),
    )  # fmt: skip
    solver: Solver = parameter(
        "auto",
        "On vertices: find distances by fast marching, or along straight segments over edges and over one "
        "or two unfolded edges, which is several times faster and closer to the truth. auto takes segments "
        f"for kernels of a radius of up to {_SEGMENTS_REACH} sample spacings (-t below 10), where that is "
        "so, and fast marching for larger ones.",
        choices=get_args(Solver), of=("vertex colours",),
    )  # fmt: skip
    free: tuple[Tunable, ...] = parameter(
        (),
        "The parameters to choose from the data by their estimated error; the others are kept. The given "
        "values are used where there is no noise. With a beta of 0 or 0 iterations nothing is chosen.",
        choices=TUNABLE, flags=(),
    )  # fmt: skip
    patches: Patches = parameter(
        "auto",
        "After the kernel, estimate similar patches together, and blend both by their estimated error. "
        "auto does so where -n, -t and --beta are all chosen from the data, and not with --fast.",
        choices=get_args(Patches), is_daily=True,
    )  # fmt: skip

    outliers: OnOutliers = parameter(
        "auto",
        "Single samples far from all their neighbours, as fireflies, salt and pepper, and dead texels are: auto "
        "replaces those that are spread at random, unlike stars, text and dither; replace takes all; keep leaves "
        "those that auto finds, and smooths the others without them.",
        choices=get_args(OnOutliers),
    )  # fmt: skip

    def __post_init__(self) -> None:
        if isinstance(self.strength, str):
            object.__setattr__(self, "strength", STRENGTHS.get(self.strength, self.strength))
        super().__post_init__()
        _ = self.given_noise

    def in_unit(self, unit: float, of_light: float) -> KernelParameters:
        """Return the parameters for colours that are divided by `unit`; `of_light` divides linear light."""
        if unit == 1:
            return self
        given = self.given_noise
        noise = self.noise if given is None or given.source else given.in_unit(unit, of_light)
        return replace(self, noise=noise, beta=None if self.beta is None else self.beta * unit)

    @property
    def given_noise(self) -> GivenNoise | None:
        """The noise given by the user; UsageError if it cannot be parsed."""
        if self.noise is None:
            return None
        try:
            return GivenNoise.parse(self.noise)
        except ValueError as error:
            raise UsageError(f"noise {error}") from None

    def with_values(self, **values: Any) -> KernelParameters:
        """Replace parameters; those given are no longer chosen from the data."""
        free = tuple(name for name in self.free if name not in values)
        return replace(self, **{"free": free, **values})

    def is_along_segments(self, spacing: float) -> bool:
        """Whether distances are measured along segments, for a mean sample spacing in units of length."""
        if self.solver == "auto":
            return self.radius <= _SEGMENTS_REACH * spacing
        return self.solver == "segments"

    def is_regularised(self, iteration: int) -> bool:
        """Whether an iteration, counted from 0, measures distances on smoothed colours."""
        return self.metric_scale > 0 and iteration < self.metric_steps

    @property
    def stabilises_noise(self) -> bool:
        """Whether the noise variance may be stabilised: not if beta is given, which refers to the input's colours."""
        return self.chooses_from_data and self.beta is None and "beta" in self.free

    @property
    def takes_patches(self) -> bool:
        """Whether patches follow the kernel if there is noise."""
        if self.patches == "auto":
            return {"iterations", "t", "beta"} <= set(self.free) and self.chooses_from_data and not self.fast
        return self.patches == "on" and self.iterations > 0

    @property
    def looks_for_outliers(self) -> bool:
        """Whether outliers are searched for: only if any step may change colours."""
        return self.iterations > 0 or self.chooses_from_data

    @property
    def chooses_from_data(self) -> bool:
        """Whether any parameter is to be chosen from the data."""
        return bool(self.free) and self.beta != 0 and (self.iterations > 0 or "iterations" in self.free)

    @property
    def radius(self) -> float:
        """Geodesic distance at which the kernel falls to the threshold: sqrt(-4 t ln threshold)."""
        return math.sqrt(-4 * self.t * math.log(self.threshold))

    @property
    def thread_count(self) -> int:
        """Number of threads: `threads`, or the CPUs available to the process."""
        if self.threads is not None:
            return self.threads
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def growth_at(iteration: int, factor: float) -> float:
    """Return the ratio of beta in an iteration, counted from 0, to beta in the first, without overflow."""
    return math.exp(min(iteration * math.log(factor), _MAX_GROWTH))


def parameters_from(
    values: Mapping[str, Any], *, choose: bool = True, fast: bool = False
) -> KernelParameters:
    """Return parameters with the given values (None: not given). The others are chosen, or have defaults."""
    given = {name: value for name, value in values.items() if value is not None}
    free = tuple(name for name in TUNABLE if name not in given) if choose else ()
    return KernelParameters(**given, free=free, fast=fast)


# t = 0.5, one iteration, threshold 0.01, 7 x 7: section 4 of A. Spira, R. Kimmel, N. Sochen (2007), the face images.
PRESETS: dict[str, dict[str, object]] = {
    "paper": {
        "iterations": 1,
        "t": 0.5,
        "threshold": 0.01,
        "window": 7,
        "metric_scale": 0.0,
        "metric_steps": 0,
        "scheme": "metric",
        "clipping": "keep",
        "solver": "fast-marching",
        "beta_growth": 1.0,
    }
}
