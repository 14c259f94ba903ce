"""What was done to a file, as a record that can be written as JSON."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.pipeline.smooth.stopwatch import peak_memory

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from beltrami_cli.flow.choice import Choice
    from beltrami_cli.formats.document import Document
    from beltrami_cli.mesh.painted import PaintedVertices
    from beltrami_cli.pipeline.settings.smooth import SmoothSettings
    from beltrami_cli.pipeline.smooth.stopwatch import Stopwatch
    from beltrami_cli.pipeline.textures.smooth import SlotReport
    from beltrami_cli.pipeline.vertices.smooth import SmoothResult


@dataclass(frozen=True)
class Change:
    """How much colour values changed: how many there are, the sums of changes and of their squares, the largest."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    @classmethod
    def between(cls, before: NDArray[np.float32], after: NDArray[np.float32]) -> Change:
        """Compare two arrays of the same shape."""
        difference = np.abs(after - before)
        if not difference.size:
            return cls()
        squares = float(np.einsum("i,i->", difference.ravel(), difference.ravel(), dtype=np.float64))
        return cls(difference.size, float(difference.sum(dtype=np.float64)), squares, float(difference.max()))

    @classmethod
    def joined(cls, changes: Iterable[Change]) -> Change:
        """Take several together."""
        parts = [dataclasses.astuple(change) for change in changes]
        counts, totals, squares, largest = zip(*parts, strict=True) if parts else ((), (), (), (0.0,))
        return cls(sum(counts), sum(totals), sum(squares), max(largest))

    def summary(self) -> dict[str, float]:
        """Return the mean, the root mean square and the largest change."""
        count = max(1, self.count)
        return {"mean": self.total / count, "rms": (self.squares / count) ** 0.5, "largest": self.largest}


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


def make_image_report(
    source: str,
    target: str,
    target_format: str,
    settings: SmoothSettings,
    image: ImageReport | None,
    watch: Stopwatch,
    files: list[str],
    warnings: list[str],
) -> SmoothReport:
    """Put together what a job did to an image."""
    return SmoothReport(
        input=source,
        output=target,
        format=target_format,
        parameters=_parameters(settings),
        vertices=None,
        textures=[],
        stages=watch.stages,
        peak_memory=peak_memory(),
        written=files,
        warnings=warnings,
        image=image,
    )


def make_report(
    source: str,
    target: str,
    target_format: str,
    document: Document,
    settings: SmoothSettings,
    vertices: SmoothResult | None,
    slots: list[SlotReport],
    watch: Stopwatch,
    files: list[str],
    warnings: list[str],
) -> SmoothReport:
    """Put together what a job did."""
    if vertices is not None and vertices.cloud is not None and vertices.cloud.outliers:
        alone = f"{vertices.cloud.outliers} of {len(vertices.colours)} points"
        warnings = [
            *warnings,
            f"{alone} are too far from others, in one line with them, or nowhere, and stay as they are",
        ]
    if vertices is not None and vertices.truncated:
        cut = (
            f"{vertices.truncated} kernels were cut short at {settings.kernel.max_samples} samples; "
            "lower t, or raise --max-samples"
        )
        warnings = [*warnings, cut]
    return SmoothReport(
        input=source,
        output=target,
        format=target_format,
        parameters=_parameters(settings),
        vertices=None if vertices is None else _vertex_report(document, vertices),
        textures=slots,
        stages=watch.stages,
        peak_memory=peak_memory(),
        written=files,
        warnings=warnings,
    )


def _parameters(settings: SmoothSettings) -> dict[str, object]:
    return {
        **dataclasses.asdict(settings.kernel),
        "threads": settings.kernel.thread_count,
        "space": settings.space,
        "channels": settings.channels,
        "on": settings.on,
        "textures": dataclasses.asdict(settings.textures),
        "image": dataclasses.asdict(settings.image),
        "level_set": dataclasses.asdict(settings.level_set),
        "embedding": dataclasses.asdict(settings.embedding),
    }


def _vertex_report(document: Document, result: SmoothResult) -> VertexReport:
    painted = document.painted()
    return VertexReport(
        counts={
            "vertices": len(painted.positions),
            "triangles": len(painted.faces) if result.cloud is None else result.cloud.triangles,
            **({} if result.cloud is None else {"outliers": result.cloud.outliers}),
            "samples": result.samples,
            "hard_edge_samples": result.hard_edge_samples,
            "samples_per_kernel": round(result.samples_per_kernel, 2),
            "truncated_kernels": result.truncated,
        },
        spacing=result.spacing,
        beta=result.beta,
        iterations=result.iterations,
        noise=result.noise,
        change=Change.between(painted.colours, result.colours).summary(),
        guides=result.guide_betas,
        geometry=_geometry_report(painted, result),
        choice=describe_choice(result.choice),
    )


def describe_choice(choice: Choice | None) -> dict[str, object] | None:
    """Return in JSON types what was chosen, and by what estimate."""
    return None if choice is None else dataclasses.asdict(choice)


def _geometry_report(painted: PaintedVertices, result: SmoothResult) -> dict[str, float] | None:
    if result.positions is None or result.normal_noise is None or result.normal_beta is None:
        return None
    moves = np.linalg.norm(result.positions - painted.positions, axis=1)
    return {
        "normal_noise": result.normal_noise,
        "normal_beta": result.normal_beta,
        "mean_move": float(moves.mean()),
        "rms_move": float(np.sqrt(np.mean(np.square(moves)))),
        "largest_move": float(moves.max()),
    }
