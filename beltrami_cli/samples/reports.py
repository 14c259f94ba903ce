"""What was done to the samples of a document; `dataclasses.asdict` of the records gives JSON types."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class SamplesReport:
    """What was done to samples of any kind.

    Attributes
    ----------
    beta : float
        As used.
    iterations : int
        How many were run: none if there is no noise, and no number was asked for.
    noise : dict of str to float
        Estimated standard deviation per channel, full scale 1, in the working space.
    noise_model : dict of str to float
        What was found of it: standard deviations at "dark", "middle" and "bright" levels (0.1, 0.5, 0.9), if they
        differ; of "quiet" and "loud" places, if they do; and "grain", the width in samples of what samples share of it.
    change : dict of str to float
        Mean, root mean square and largest change of a value that is smoothed, of texels those that are covered, full
        scale 1, as stored.
    guides : dict of str to float
        The beta used for each guide, by its name.
    choice : dict or None
        If parameters were chosen from the data: "chosen" with their values, and what is known of the result: its
        estimated "psnr" in dB, the standard "error" of that, the "gain" over the input, and the numbers of "candidates"
        that were compared and of "samples" that they were compared on.
    patches : float or None
        The share of the result that was taken from patches; None if only the kernel was run.
    """

    beta: float
    iterations: int
    noise: dict[str, float]
    noise_model: dict[str, float]
    change: dict[str, float] = field(default_factory=dict)
    guides: dict[str, float]
    choice: dict[str, object] | None
    patches: float | None


@dataclass(frozen=True, kw_only=True)
class VertexReport(SamplesReport):
    """What was done to vertex colours, besides what `SamplesReport` says.

    Attributes
    ----------
    counts : dict
        Vertices, triangles, samples, samples of hard edges, samples per kernel, truncated kernels. For points without
        faces the triangles are those around each, and there are "outliers": points in none of them, left as they are.
    spacing : float
        Mean sample spacing, in the file's own unit of length.
    geometry : dict of str to float, or None
        If positions were smoothed: the estimated noise of the normals in radians, the beta used for them, and the mean,
        root mean square and largest distance that a vertex moved, in the file's own unit of length.
    """

    counts: dict[str, float]
    spacing: float
    geometry: dict[str, float] | None = None


@dataclass(frozen=True, kw_only=True)
class SlotReport(SamplesReport):
    """What was done to the textures of a slot, besides what `SamplesReport` says.

    Attributes
    ----------
    slot : str
        The slot.
    textures : list of dict
        For each texture its name, size, type, and how many of its texels the surface covers.
    counts : dict of str to int
        Charts, seams, jumps, covered and overlapped texels of all textures together; jumps are seams whose two
        sides really differ, which nothing was smoothed over.
    pitch : float
        Mean distance of neighbouring texels on the surface, in the model's own unit of length.
    samples_per_kernel : float
        Mean number of samples that a kernel held.
    """

    slot: str
    textures: list[dict[str, object]]
    counts: dict[str, int]
    pitch: float
    samples_per_kernel: float


@dataclass(frozen=True, kw_only=True)
class ImageReport(SamplesReport):
    """What was done to an image, besides what `SamplesReport` says.

    Attributes
    ----------
    image : dict
        Its size, format and channels, which of them were smoothed, on which surface ("plane", "height" or "positions"),
        and how many of its pixels are holes.
    pitch : float
        Mean distance of neighbouring pixels on the surface, in its own unit of length.
    samples_per_kernel : float
        Mean number of pixels that a kernel held.
    """

    image: dict[str, object]
    pitch: float
    samples_per_kernel: float


@dataclass(frozen=True)
class LevelReport:
    """What was found of exposure steps, and done to them.

    Attributes
    ----------
    what : str
        Which colours.
    charts, seams : int
        Charts of textures, or parts of vertices by photograph, and seams between two of them.
    stepped, painted : int
        Seams with a mean step of 2/255 or more, and seams whose steps are taken for paint.
    before, after : float
        Median over all seams, by length, of the mean step, full scale 1, in the working space.
    foretold : float
        The share of the energy of steps that fits to other seams foretell, from which it is decided.
    tilted : bool
        Whether gains change over charts, as by vignetting.
    levelled : bool
        Whether colours were changed.
    reason : str
        Why not, if they were not.
    change : dict of str to float
        As for `SamplesReport`.
    exposures : list of dict
        For each chart with seams its number, its texture and place there (the column and row of its centre), its
        texels, and the gain and offset per channel that it was exposed with, in the working space.
    """

    what: str
    charts: int
    seams: int
    stepped: int
    painted: int
    before: float
    after: float
    foretold: float
    tilted: bool
    levelled: bool
    reason: str
    change: dict[str, float] = field(default_factory=dict)
    exposures: list[dict[str, object]] = field(default_factory=list)
