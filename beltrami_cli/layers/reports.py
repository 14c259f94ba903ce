"""What was done to the samples of a document; `dataclasses.asdict` of the records gives JSON types.

Noise and changes are of full scale 1: noise in the working space, changes as stored.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class LayerReport:
    """What was done to samples of any kind."""

    beta: float  # as used
    iterations: int  # how many were run: none if there is no noise, and no number was asked for
    noise: dict[str, float]  # estimated standard deviation per channel
    # Standard deviations at "dark", "middle" and "bright" levels (0.1, 0.5, 0.9), if they differ; of "quiet" and "loud"
    # places, if they do; and "grain", the width in samples of what samples share of it.
    noise_model: dict[str, float]
    # Mean, root mean square and largest change of a smoothed value; of covered texels only.
    change: dict[str, float] = field(default_factory=dict)
    guides: dict[str, float]  # the beta used for each guide, by its name
    # If parameters were chosen from the data: "chosen" with their values, and estimates of the result: its
    # estimated "psnr" in dB, the standard "error" of that, the "gain" over the input, and the numbers of "candidates"
    # that were compared and of "samples" that they were compared on.
    choice: dict[str, object] | None
    patches: float | None  # the share of the result that is from patches; None: only the kernel was run


@dataclass(frozen=True, kw_only=True)
class VertexReport(LayerReport):
    """What was done to vertex colours, besides."""

    # Vertices, triangles, samples, samples of hard edges, samples per kernel, truncated kernels. For points without
    # faces the triangles are those around each, and there are "outliers": points in none of them, left as they are.
    counts: dict[str, float]
    spacing: float  # mean distance of samples, in the file's own unit of length
    # If positions were smoothed: the estimated noise of the normals in radians, the beta used for them, and the mean,
    # root mean square and largest distance that a vertex moved, in the file's own unit of length.
    geometry: dict[str, float] | None = None

    def warnings(self, max_samples: int) -> list[str]:
        """Return warnings for users; kernels held at most `max_samples`."""
        found, outliers = list[str](), self.counts.get("outliers", 0)
        if outliers:
            alone = "is left as it is: it is" if outliers == 1 else "are left as they are: they are"
            where = "too far from others, in one line with them, or nowhere"
            found.append(f"{outliers} of {self.counts['vertices']} points {alone} {where}")
        if truncated := self.counts["truncated_kernels"]:
            remedy = "lower t, or raise --max-samples"
            found.append(f"{truncated} kernels were cut short at {max_samples} samples; {remedy}")
        return found


@dataclass(frozen=True, kw_only=True)
class SlotReport(LayerReport):
    """What was done to the textures of a slot, besides."""

    slot: str
    textures: list[dict[str, object]]  # name, size, type, and how much of its texels the surface covers
    # Charts, seams, jumps, covered and overlapped texels of all textures together; jumps are seams whose two sides
    # really differ, which nothing was smoothed over.
    counts: dict[str, int]
    pitch: float  # mean distance of neighbouring texels on the surface, in the model's own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True, kw_only=True)
class ImageReport(LayerReport):
    """What was done to an image, besides."""

    # Its size, format and channels, which of them were smoothed, on which surface ("plane", "height" or "positions"),
    # and how many of its pixels are holes.
    image: dict[str, object]
    pitch: float  # mean distance of neighbouring pixels on the surface, in its own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True)
class LevelReport:
    """What was found of exposure steps, and done to them."""

    what: str  # which colours
    charts: int  # charts of textures, or parts of vertices by photograph
    seams: int  # between two of them
    stepped: int  # seams with a mean step of 2/255 or more
    painted: int  # seams whose steps are taken for paint
    before: float  # median over all seams, by length, of the mean step, full scale 1, in the working space
    after: float
    explained: float  # the share of the steps at held-out seams that one exposure per chart explains
    tilted: bool  # whether gains change over charts, as by vignetting
    levelled: bool  # whether colours were changed
    reason: str  # why not, if they were not
    change: dict[str, float] = field(default_factory=dict)  # as for `LayerReport`
    # For each chart with seams its number, its texture and place there (the column and row of its centre), its texels,
    # and the gain and offset per channel that it was exposed with, in the working space.
    exposures: list[dict[str, object]] = field(default_factory=list)
