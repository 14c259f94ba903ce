"""The parameters of the short-time kernel, with their defaults and what values they may take."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Literal, get_args

from beltrami_cli.errors import UsageError

Weights = Literal["uniform", "area"]
Units = Literal["spacing", "world"]
Space = Literal["srgb", "linear", "oklab", "data"]


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
    threshold : float
        Samples with a kernel value below it are left out, in (0, 1).
    weights : {"uniform", "area"}
        w_q of eq. (9): 1, or the area in space that the sample stands for.
    units : {"spacing", "world"}
        Unit of length: the mean sample spacing of the surface, or the surface's own.
    max_samples : int
        A kernel stops growing at this many samples; a guard against a `t` that is too large for the mesh.
    threads : int or None
        None: as many as the process may use. The result is the same for any number.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """

    iterations: int = 3
    t: float = 2.4
    beta: float | None = None
    threshold: float = 0.01
    weights: Weights = "uniform"
    units: Units = "spacing"
    max_samples: int = 2000
    threads: int | None = None

    def __post_init__(self) -> None:
        _require(self.iterations >= 0, "iterations", self.iterations, "0 or more")
        _require(self.t > 0 and math.isfinite(self.t), "t", self.t, "a positive number")
        _require(
            self.beta is None or (self.beta >= 0 and math.isfinite(self.beta)), "beta", self.beta, "0 or more"
        )
        _require(0 < self.threshold < 1, "threshold", self.threshold, "between 0 and 1")
        _require(self.weights in get_args(Weights), "weights", self.weights, "uniform or area")
        _require(self.units in get_args(Units), "units", self.units, "spacing or world")
        _require(self.max_samples >= 1, "max_samples", self.max_samples, "1 or more")
        _require(self.threads is None or self.threads >= 1, "threads", self.threads, "1 or more")

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


def _require(holds: bool, name: str, value: object, allowed: str) -> None:
    if not holds:
        raise UsageError(f"{name} is {value}, but must be {allowed}")
