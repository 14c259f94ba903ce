"""The parameters of the short-time kernel, with their defaults and what values they may take."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from beltrami_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

Weights = Literal["uniform", "area"]
Units = Literal["spacing", "world"]
Scheme = Literal["triangles", "metric"]
Space = Literal["srgb", "linear", "oklab", "data"]
Clipping = Literal["restore", "keep"]
Solver = Literal["auto", "fast-marching", "segments"]
Strength = Literal["gentle", "normal", "strong"]
Tunable = Literal["iterations", "t", "beta", "beta_growth", "metric_steps"]

# The parameters that can be chosen from the data.
TUNABLE: tuple[Tunable, ...] = get_args(Tunable)

# How much the smoothness of the result counts beside its closeness to the input.
SMOOTHNESS: dict[Strength, float] = {"gentle": 0.7, "normal": 1.0, "strong": 1.5}


# The error of distances along segments stays the same on ever finer meshes, that of fast marching shrinks: on level
# lattices both are 2.5 per cent at this radius, in sample spacings. On noisy colours segments are better at any.
_SEGMENTS_REACH = 14


# Logarithm of the growth at which any difference in colour is far beyond the kernel, and numbers do not overflow yet.
_MOST_GROWTH = 25.0


@dataclass(frozen=True)
class KernelParameters:
    """What the kernel is run with; the record holds the defaults.

    Attributes
    ----------
    iterations : int
        N >= 0; the flow is run for about the time N t.
    t : float
        Time step, > 0, in squared units of length: without an edge nearby, the kernel is a Gaussian of
        variance 2 t on the surface.
    beta : float or None
        Units of length per unit of colour, >= 0: how much a colour difference counts as distance. 0 is the
        linear kernel. None: from the estimated noise, `choose_beta`.
    beta_growth : float
        Factor, >= 1, by which beta grows from one iteration to the next, as the noise that is left shrinks.
    threshold : float
        Samples with a kernel value below it are left out, in (0, 1).
    weights : {"uniform", "area"}
        w_q of eq. (9): 1, or the area in space that the sample stands for.
    units : {"spacing", "world"}
        Unit of length: the local mean sample spacing of the surface, or the surface's own.
    max_samples : int
        A kernel stops growing at this many samples; a guard against a `t` that is too large for the mesh.
    threads : int or None
        None: as many as the process may use. The result is the same for any number.
    window : int
        On textures and images: samples a side of the square that a kernel is looked for in, odd. From 3 to 15 by
        vectorised sweeps; beyond, by a heap march.
    metric_scale : float
        In the first `metric_steps` iterations distances are taken from colours that were smoothed by a Gaussian of
        this standard deviation, in sample spacings; averages are always taken over the colours themselves. 0: never.
    metric_steps : int
        How many of the iterations have the regularised metric; the rest are plain.
    scheme : {"triangles", "metric"}
        On textures and images: distances through the triangles of neighbouring samples; or the paper's, by a heap
        march over the quadrants of the grid with the metric from central differences, obtuse ones split by it.
    clipping : {"restore", "keep"}
        Whether averages are corrected where noise was cut off at 0 or full scale; never with a `beta` of 0, which
        is a linear kernel.
    solver : {"auto", "fast-marching", "segments"}
        How distances on triangles are found: by fast marching from every vertex, or along straight segments over edges
        and over one or two unfolded edges, from sixteen vertices at once. auto: along segments, but by fast marching
        in kernels of a radius above 14 sample spacings.
    free : tuple of str
        Those of iterations, t, beta, beta_growth and metric_steps that are chosen from the data, by their estimated
        error, see `choose`; the others are kept. The values given here are used where there is no noise to tell
        by. A `beta` of 0 leaves nothing to choose, nor do 0 iterations.
    fast : bool
        Whether what is free follows a fixed rule for the noise, and is not chosen by the estimated error.
    strength : {"gentle", "normal", "strong"}
        Whether what is chosen smooths less or more than what is estimated to be best. It moves a `beta` of None, too.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """

    iterations: int = 5
    t: float = 2.4
    beta: float | None = None
    beta_growth: float = 2.0
    threshold: float = 0.01
    weights: Weights = "uniform"
    units: Units = "spacing"
    max_samples: int = 2000
    threads: int | None = None
    window: int = 7
    metric_scale: float = 0.5
    metric_steps: int = 2
    scheme: Scheme = "triangles"
    clipping: Clipping = "restore"
    solver: Solver = "auto"
    free: tuple[Tunable, ...] = ()
    fast: bool = False
    strength: Strength = "normal"

    def __post_init__(self) -> None:
        _require(self.iterations >= 0, "iterations", self.iterations, "0 or more")
        _require(self.t > 0 and math.isfinite(self.t), "t", self.t, "a positive number")
        _require(
            self.beta is None or (self.beta >= 0 and math.isfinite(self.beta)), "beta", self.beta, "0 or more"
        )
        _require(1 <= self.beta_growth <= 100, "beta_growth", self.beta_growth, "between 1 and 100")
        _require(0 < self.threshold < 1, "threshold", self.threshold, "between 0 and 1")
        _require(self.weights in get_args(Weights), "weights", self.weights, "uniform or area")
        _require(self.units in get_args(Units), "units", self.units, "spacing or world")
        _require(self.max_samples >= 1, "max_samples", self.max_samples, "1 or more")
        _require(self.window >= 3 and self.window % 2 == 1, "window", self.window, "odd, and 3 or more")
        _require(0 <= self.metric_scale <= 3, "metric_scale", self.metric_scale, "between 0 and 3")
        _require(self.metric_steps >= 0, "metric_steps", self.metric_steps, "0 or more")
        _require(self.scheme in get_args(Scheme), "scheme", self.scheme, "triangles or metric")
        _require(self.clipping in get_args(Clipping), "clipping", self.clipping, "restore or keep")
        _require(self.strength in get_args(Strength), "strength", self.strength, "gentle, normal or strong")
        _require(set(self.free) <= set(TUNABLE), "free", self.free, f"some of {', '.join(TUNABLE)}")
        allowed = "auto, fast-marching or segments"
        _require(self.solver in get_args(Solver), "solver", self.solver, allowed)
        _require(self.threads is None or self.threads >= 1, "threads", self.threads, "1 or more")

    def is_along_segments(self, spacing: float) -> bool:
        """Tell whether distances on triangles are found along segments, and not by fast marching.

        Parameters
        ----------
        spacing : float
            Mean sample spacing in units of length.
        """
        if self.solver == "auto":
            return self.radius <= _SEGMENTS_REACH * spacing
        return self.solver == "segments"

    def is_regularised(self, iteration: int) -> bool:
        """Tell whether an iteration, counted from 0, takes distances from smoothed colours."""
        return self.metric_scale > 0 and iteration < self.metric_steps

    def growth(self, iteration: int) -> float:
        """Return by what factor beta is larger in an iteration, counted from 0, than in the first."""
        return math.exp(min(iteration * math.log(self.beta_growth), _MOST_GROWTH))

    @property
    def is_open(self) -> bool:
        """Whether there is anything to choose from the data."""
        return bool(self.free) and self.beta != 0 and (self.iterations > 0 or "iterations" in self.free)

    @property
    def radius(self) -> float:
        """Geodesic distance at which the kernel falls to the threshold: sqrt(-4 t ln threshold)."""
        return math.sqrt(-4 * self.t * math.log(self.threshold))

    @property
    def thread_count(self) -> int:
        """Threads to use: `threads`, or as many as the process is allowed."""
        if self.threads is not None:
            return self.threads
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parameters_with(
    values: Mapping[str, Any], *, choose: bool = True, fast: bool = False
) -> KernelParameters:
    """Make parameters of which some are given, and leave those that are not to be chosen.

    Parameters
    ----------
    values : mapping of str to object
        Names and values; None for a parameter that is not given.
    choose : bool
        Whether those of `TUNABLE` that are not given are chosen from the data; else they have their defaults.
    fast : bool
        Whether that is by a fixed rule for the noise.

    Returns
    -------
    KernelParameters

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    given = {name: value for name, value in values.items() if value is not None}
    free = tuple(name for name in TUNABLE if name not in given) if choose else ()
    return KernelParameters(**given, free=free, fast=fast)


def _require(holds: bool, name: str, value: object, allowed: str) -> None:
    if not holds:
        raise UsageError(f"{name} is {value}, but must be {allowed}")


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
