"""Reports of the changes of layers.

Full scale is 1: noise refers to the working space, changes to stored values. `dataclasses.asdict` of a report gives
JSON types.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from beltrami_cli.arrays import Float64s
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.noise.model import Reading


def named(names: Sequence[str], values: Float64s) -> dict[str, float]:
    """Pair values with the names of their channels."""
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def describe_choice(choice: Choice | None, unit: float) -> dict[str, object] | None:
    """Describe the choice of parameters for colours that were divided by a unit, in JSON types."""
    if choice is None:
        return None
    choice = choice.in_unit(unit)
    interval = None if choice.interval is None else list(choice.interval)
    return {**dataclasses.asdict(choice), "interval": interval}


def describe_reading(reading: Reading | None, unit: float) -> dict[str, float] | None:
    """Describe the estimated size of the noise of colours that were divided by a unit; None if it was given."""
    if reading is None:
        return None
    sizes = {name: unit * getattr(reading, name) for name in ("low", "median", "high")}
    return {"none": reading.none, "visible": reading.visible, **sizes}


@dataclass(frozen=True, kw_only=True)
class LayerReport:
    beta: float  # as used
    iterations: int  # 0 without noise, unless a number was given
    noise: dict[str, float]  # standard deviation per channel, estimated or given; 0: none is removed
    # Estimated size of the noise, RMS of full scale 1: the probabilities of no noise ("none") and of visible noise
    # ("visible"); given that there is noise, its "median", and "low" and "high", its interval with a certainty of 90 %.
    # None: the noise is given.
    reading: dict[str, float] | None
    # Standard deviations at "dark", "middle" and "bright" levels (0.1, 0.5, 0.9), and of "quiet" and "loud" places, if
    # they differ; "grain", the width in samples over which noise is shared.
    noise_model: dict[str, float]
    # Mean, RMS and largest change of a smoothed value; only of covered texels.
    change: dict[str, float] = field(default_factory=dict)
    guides: dict[str, float]  # beta of each guide, by name
    # If parameters were chosen from the data: "chosen" values, the estimated "psnr" in dB, its standard "error" given
    # the noise, the "gain" over the input, and the numbers of "candidates" compared and of "samples" they were compared
    # on. "predicted" has the PSNR "before", "psnr" after, and its "least" and "most" with a certainty of 90 %, as in
    # messages; None: the noise is not known well enough.
    choice: dict[str, object] | None
    patches: float | None  # mean weight of patches; None: only the kernel was run
    # If there are outliers: their "count", "share" of all samples, and whether they were "replaced".
    wrong_samples: dict[str, Any]

    def warnings(self, max_samples: int) -> list[str]:
        """Return warnings for users; `max_samples`: limit of samples per kernel."""
        del max_samples
        return []


@dataclass(frozen=True, kw_only=True)
class VertexReport(LayerReport):
    # Vertices, triangles, samples, samples of hard edges, samples per kernel, truncated kernels. For points without
    # faces the triangles are those around each, and there are "outliers": points in none of them, left as they are.
    counts: dict[str, float]
    spacing: float  # mean distance of samples, in the file's own unit of length
    # If positions were smoothed: the estimated noise of the normals in radians, the beta used for them, and the mean,
    # root mean square and largest distance that a vertex moved, in the file's own unit of length.
    geometry: dict[str, float] | None = None

    def warnings(self, max_samples: int) -> list[str]:
        messages, outliers = list[str](), self.counts.get("outliers", 0)
        if outliers:
            alone = "is left as it is: it is" if outliers == 1 else "are left as they are: they are"
            where = "too far from others, in one line with them, or nowhere"
            messages.append(f"{outliers} of {self.counts['vertices']} points {alone} {where}")
        if truncated := self.counts["truncated_kernels"]:
            remedy = "lower t, or raise --max-samples"
            messages.append(f"{truncated} kernels were cut short at {max_samples} samples; {remedy}")
        return messages


@dataclass(frozen=True, kw_only=True)
class SlotReport(LayerReport):
    slot: str
    textures: list[dict[str, object]]  # name, size, type, and coverage
    # Numbers of charts, seams, jumps, covered and overlapped texels of all textures together. Jumps are seams whose
    # sides differ; nothing is smoothed across them.
    counts: dict[str, int]
    pitch: float  # mean distance of neighbouring texels on the surface, in the model's own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True, kw_only=True)
class ImageReport(LayerReport):
    # Size, format, channels, smoothed channels, kind of surface ("plane", "height" or "positions"), and number of
    # holes.
    image: dict[str, object]
    pitch: float  # mean distance of neighbouring pixels on the surface, in its own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True)
class LevelReport:
    what: str  # name of the colours
    charts: int  # number of charts, or of connected vertices of one photograph
    seams: int  # number of seams between charts
    stepped: int  # number of seams with a mean step of 2/255 or more
    painted: int  # seams whose steps are edges of colour
    before: float  # median over all seams, by length, of the mean step, full scale 1, in the working space
    after: float
    explained: float  # share of the steps at held-out seams explained by one exposure per chart
    tilted: bool  # whether gains vary within charts, as with vignetting
    levelled: bool  # whether colours were changed
    reason: str  # of not changing them
    change: dict[str, float] = field(default_factory=dict)  # as for `LayerReport`
    # For each chart with seams: its number, texture, column and row of one of its texels, number of texels, and gain
    # and offset per channel of its exposure, in the working space.
    exposures: list[dict[str, object]] = field(default_factory=list)
