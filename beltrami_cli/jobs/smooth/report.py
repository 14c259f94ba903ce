"""What was done to a file, as a record that can be written as JSON."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

_HEAD = re.compile(rb'\{\n  "input": ".*",\n  "output": ".*",\n  "format": "\w+",\n  "parameters": \{')

if TYPE_CHECKING:
    from beltrami_cli.samples.textures.smooth import SlotReport


@dataclass(frozen=True)
class VertexReport:
    """What was done to vertex colours.

    Attributes
    ----------
    counts : dict
        Vertices, triangles, samples, samples of hard edges, samples per kernel, truncated kernels. For points without
        faces the triangles are those around each, and there are "outliers": points in none of them, left as they are.
    spacing : float
        Mean sample spacing, in the file's own unit of length.
    beta : float
        As used.
    iterations : int
        How many were run: none if there is no noise, and no number was asked for.
    noise : dict of str to float
        Estimated standard deviation per channel, full scale 1, in the working space.
    change : dict of str to float
        Mean, root mean square and largest change of a colour value, full scale 1, as stored.
    guides : dict of str to float
        The beta used for each guide, by its name.
    geometry : dict of str to float, or None
        If positions were smoothed: the estimated noise of the normals in radians, the beta used for them, and the mean,
        root mean square and largest distance that a vertex moved, in the file's own unit of length.
    choice : dict or None
        If parameters were chosen from the data: "chosen" with their values, and what is known of the result: its
        estimated "psnr" in dB, the standard "error" of that, the "gain" over the input, and the numbers of "candidates"
        that were compared and of "samples" that they were compared on.
    """

    counts: dict[str, float]
    spacing: float
    beta: float
    iterations: int
    noise: dict[str, float]
    change: dict[str, float]
    guides: dict[str, float]
    geometry: dict[str, float] | None
    choice: dict[str, object] | None = None


@dataclass(frozen=True)
class ImageReport:
    """What was done to an image.

    Attributes
    ----------
    image : dict
        Its size, format and channels, which of them were smoothed, on which surface ("plane", "height" or "positions"),
        and how many of its pixels are holes.
    pitch : float
        Mean distance of neighbouring pixels on the surface, in its own unit of length.
    beta : float
        As used.
    iterations : int
        How many were run: none if there is no noise, and no number was asked for.
    noise : dict of str to float
        Estimated standard deviation per channel, full scale 1, in the working space.
    samples_per_kernel : float
        Mean number of pixels that a kernel held.
    guides : dict of str to float
        The beta used for each guide, by its name.
    change : dict of str to float
        Mean, root mean square and largest change of a smoothed value, full scale 1, as stored.
    choice : dict or None
        As for `VertexReport`.
    """

    image: dict[str, object]
    pitch: float
    beta: float
    iterations: int
    noise: dict[str, float]
    samples_per_kernel: float
    guides: dict[str, float]
    change: dict[str, float]
    choice: dict[str, object] | None = None


@dataclass(frozen=True)
class SmoothReport:
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Where from, where to, and the format written.
    parameters : dict
        The parameters that were asked for; those named in "free" were left to be chosen, and what was chosen is with
        what it was chosen for.
    vertices : VertexReport or None
        For vertex colours, if they were smoothed.
    textures : list of SlotReport
        For the texture slots that were smoothed.
    stages : dict
        "wall" and "cpu" seconds per stage.
    peak_memory : int or None
        Largest resident size of the process in bytes.
    written : list of str
        The files that were written; none on a dry run.
    warnings : list of str
        What the user should know.
    image : ImageReport or None
        For an image, if it was smoothed.
    """

    input: str
    output: str
    format: str
    parameters: dict[str, object]
    vertices: VertexReport | None
    textures: list[SlotReport]
    stages: dict[str, dict[str, float]]
    peak_memory: int | None
    written: list[str]
    warnings: list[str]
    image: ImageReport | None = None


def is_report(head: bytes) -> bool:
    """Tell by its first bytes whether a file is a `SmoothReport` as JSON."""
    return _HEAD.match(head) is not None
