"""Parameters of the short-time kernel: defaults, limits, and what they imply."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import check, described, parameter
from beltrami_cli.quantities import BYTE_STEP, sure_amount

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

# Probability, of no noise or of some noise, below which that case is ignored: one in ten.
NEGLIGIBLE = 0.1

# Visible noise, of full scale: with less, most samples are within a step of 8 bits of their value.
VISIBLE = 2 * BYTE_STEP

_CHANNELS_OF_COLOUR = 3

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
MAX_GROWTH = 25.0

_CAMERA = re.compile(r"shot:([^,]+),read:([^,]+)")

# A file of standard deviations is recognised by its extension.
_SOURCE = re.compile(r"(frame|attribute):(.+)|()(.+\.[A-Za-z]\w*)")


@dataclass(frozen=True)
class GivenNoise:
    """Noise that the user gives: a standard deviation, or shot and read noise of full scale 1 in linear light."""

    sigma: float = 0.0
    shot: float = 0.0
    read: float = 0.0
    source: str = ""  # file or vertex attribute with a value per sample
    kind: str = ""  # of the source: "frame", "attribute", or else standard deviations

    @property
    def is_by_level(self) -> bool:
        """Whether the noise depends on the level of colours."""
        return self.shot > 0 or self.read > 0


_NOISE_FORMS = (
    "a number of 255 such as 12 or 0.9/255, a share of full scale such as 4.7%, "
    "shot:A,read:B such as shot:0.01,read:0.005, or a file of standard deviations such as sigma.exr, "
    "frame:FILE or attribute:NAME"
)


def given_noise(text: str) -> GivenNoise:
    """Read "12" or "12/255" of 255, "4.7%" of full scale, "shot:A,read:B", or a source; or ValueError."""
    camera, source = _CAMERA.fullmatch(text.strip()), _SOURCE.fullmatch(text)
    if camera is None:
        if source is None:
            return GivenNoise(sure_amount(text, _NOISE_FORMS))
        return GivenNoise(source=source[2] or source[4], kind=source[1] or "")
    try:
        shot, read = map(float, camera.groups())
    except ValueError:
        raise ValueError(f"is {text!r}, but must be {_NOISE_FORMS}") from None
    if not (0 <= shot <= 1 and 0 <= read <= 1):
        raise ValueError(f"is {text!r}, but shot and read are between 0 and 1, of full scale")
    return GivenNoise(shot=shot, read=read)


def file_of_noise(text: str) -> str:
    """Return the file that a value of `noise` names, or an empty string."""
    source = _SOURCE.fullmatch(text)
    return "" if source is None or source[1] == "attribute" else source[2] or source[4]


def _strength_in(text: str) -> float:
    try:
        return STRENGTHS[text] if text in STRENGTHS else float(text)
    except ValueError:
        raise ValueError(f"is {text!r}, but must be {_STRENGTH_RANGE}") from None


def _strength_shown(value: float) -> str:
    return next((name for name, weight in STRENGTHS.items() if weight == value), f"{value:g}")


@described
@dataclass(frozen=True)
class KernelParameters:
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
        "The noise if it is known: 12 (of 255), 4.7%, or a FILE with that of each sample. For JPEG files it "
        "is that before coding, and messages state what is left of it. That of a camera is "
        "shot:A,read:B (variance A L + B^2 of light L); frame:FILE and attribute:NAME see beltrami docs tuning.",
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
        check(self)
        _ = self.given_noise

    def in_unit(self, unit: float, of_light: float) -> KernelParameters:
        """Return the parameters for colours that are divided by `unit`; `of_light` divides linear light."""
        given, noise = self.given_noise, self.noise
        if unit == 1:
            return self
        if (
            given is not None and given.is_by_level
        ):  # var(L / u) = (A / u) (L / u) + (B / u)^2, and L is light
            shot, read = (min(1.0, each / of_light) for each in (given.shot, given.read))
            noise = f"shot:{shot!r},read:{read!r}"
        elif given is not None and not given.source:
            noise = f"{100 * min(1.0, given.sigma / unit)!r}%"
        return replace(self, noise=noise, beta=None if self.beta is None else self.beta * unit)

    @property
    def given_noise(self) -> GivenNoise | None:
        """The noise given by the user; UsageError if it cannot be parsed."""
        if self.noise is None:
            return None
        try:
            return given_noise(self.noise)
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

    def growth(self, iteration: int) -> float:
        """Return the ratio of beta in an iteration, counted from 0, to beta in the first."""
        return math.exp(min(iteration * math.log(self.beta_growth), MAX_GROWTH))

    @property
    def stabilises_noise(self) -> bool:
        """Whether the noise variance may be stabilised: not if beta is given, which refers to the input's colours."""
        return self.is_open and self.beta is None and "beta" in self.free

    @property
    def takes_patches(self) -> bool:
        """Whether patches follow the kernel if there is noise."""
        if self.patches == "auto":
            return {"iterations", "t", "beta"} <= set(self.free) and self.is_open and not self.fast
        return self.patches == "on" and self.iterations > 0

    @property
    def looks_for_outliers(self) -> bool:
        """Whether outliers are searched for: only if any step may change colours."""
        return self.iterations > 0 or self.is_open

    @property
    def is_open(self) -> bool:
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


def parameters_with(
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


def noise_size(part: Mapping[str, Any]) -> float:
    """Return the noise of a part of a report, or of `info`, as one number of full scale 1; 0: none is removed.

    Where it was estimated, it is the median of the estimate; the noise by channel is what is removed.
    """
    noise, reading = part["noise"], part.get("reading")  # which older records of a batch do not have
    if reading is None or not any(noise.values()):
        return root_mean_square(noise)
    return float(reading["median"])


def root_mean_square(noise: Mapping[str, float]) -> float:
    """Return the root mean square of noise by channel, without that of alpha."""
    colours = [*noise.values()][:_CHANNELS_OF_COLOUR]
    return math.sqrt(sum(sigma**2 for sigma in colours) / max(1, len(colours)))
