"""Smooth the colours of a file: read, sample, iterate, write."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.source import open_document
from beltrami_cli.pipeline.conversion import convert
from beltrami_cli.pipeline.output import Output
from beltrami_cli.pipeline.settings import DEFAULTS, OUTPUT_FORMATS, SmoothSettings
from beltrami_cli.pipeline.smooth_vertices import SmoothResult, require_surface, smooth_painted
from beltrami_cli.pipeline.stopwatch import Stopwatch, peak_memory

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.mesh.painted import PaintedVertices


@dataclass(frozen=True)
class SmoothReport:
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Where from, where to, and the format written.
    parameters : dict
        The kernel's parameters as used, the working space and the channels.
    counts : dict
        Vertices, triangles, samples, samples of hard edges, samples per kernel, truncated kernels.
    spacing : float
        Unit of length that was used, in the file's own.
    noise : dict of str to float
        Estimated standard deviation per channel, full scale 1, in the working space.
    change : dict of str to float
        Mean, root mean square and largest change of a colour value, full scale 1, as stored.
    stages : dict
        "wall" and "cpu" seconds per stage.
    peak_memory : int or None
        Largest resident size of the process in bytes.
    written : list of str
        The files that were written; none on a dry run.
    warnings : list of str
        What the user should know.
    """

    input: str
    output: str
    format: str
    parameters: dict[str, object]
    counts: dict[str, float]
    spacing: float
    noise: dict[str, float]
    change: dict[str, float]
    stages: dict[str, dict[str, float]]
    peak_memory: int | None
    written: list[str]
    warnings: list[str]


def smooth_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    settings: SmoothSettings = DEFAULTS,
    *,
    format: str | None = None,  # noqa: A002 -- the name of the option
    overwrite: bool = False,
    dry_run: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SmoothReport:
    """Smooth the vertex colours of a mesh file, and change nothing else.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB; "-" for standard input or output. Another extension converts.
    settings : SmoothSettings
        The kernel's parameters, the working space and the channels.
    format : {"ply", "obj", "glb", "gltf"}, optional
        Format to write where the name of `target` does not tell.
    overwrite : bool
        Whether existing files may be replaced.
    dry_run : bool
        Compute everything and write nothing.
    progress : callable, optional
        Called with the samples done so far and the samples to do; may raise to stop.

    Returns
    -------
    SmoothReport

    Raises
    ------
    UsageError
        If the format cannot be told, or settings contradict each other or the file.
    InputError
        If the source cannot be read or holds no vertex colours.
    OutputError
        If the target cannot be written; existing files are as they were.
    """
    source, target = os.fspath(source), os.fspath(target)
    watch = Stopwatch()
    output = None if dry_run else Output(target, overwrite=overwrite)
    with watch.stage("read"):
        document = open_document(source)
        target_format = _target_format(document, target, format)
        painted = document.painted()
        require_surface(painted, document.name)
        moved = _is_moved(source, target)
        references = list(document.references()) if moved and target_format == document.format else []
    if output is not None:
        output.check_sidecars(references)
    with watch.stage("smooth"):
        result = smooth_painted(painted, settings, progress)
    with watch.stage("write"):
        written = _make_files(document, result.colours, target_format, target, moved=moved)
        for name in references:
            written = dataclasses.replace(
                written, sidecars={**written.sidecars, name: (Path(source).parent / name).read_bytes()}
            )
        if output is not None:
            output.write(written)
    files = [] if output is None else [target, *written.sidecars]
    warnings = [*document.notices, *written.notices, *_warnings(result, settings)]
    return _report(source, target, target_format, painted, settings, result, watch, files, warnings)


def _target_format(document: Document, target: str, chosen: str | None) -> str:
    told = chosen or Path(target).suffix.lower().lstrip(".")
    if told in OUTPUT_FORMATS:
        return told
    if target == "-" or not told:
        return document.format
    raise UsageError(
        f"{target}: no format is known for .{told}; end the name in {', '.join('.' + f for f in OUTPUT_FORMATS)}, "
        "or say --format"
    )


def _is_moved(source: str, target: str) -> bool:
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent


def _make_files(
    document: Document, colours: NDArray[np.float32], target_format: str, target: str, *, moved: bool
) -> Written:
    stem = Path(target).stem
    if target_format == document.format:
        return document.patch(colours, stem, moved=moved)
    return convert(document, colours, target_format, stem, moved=moved)


def _warnings(result: SmoothResult, settings: SmoothSettings) -> list[str]:
    if not result.truncated:
        return []
    return [
        f"{result.truncated} kernels were cut short at {settings.kernel.max_samples} samples; "
        "lower t, or raise --max-samples"
    ]


def _report(
    source: str,
    target: str,
    target_format: str,
    painted: PaintedVertices,
    settings: SmoothSettings,
    result: SmoothResult,
    watch: Stopwatch,
    files: list[str],
    warnings: list[str],
) -> SmoothReport:
    kernel = dataclasses.replace(settings.kernel, beta=result.beta)
    return SmoothReport(
        input=source,
        output=target,
        format=target_format,
        parameters={
            **dataclasses.asdict(kernel),
            "threads": kernel.thread_count,
            "beta_chosen": settings.kernel.beta is None,
            "space": settings.space,
            "channels": list(result.noise),
        },
        counts={
            "vertices": len(painted.positions),
            "triangles": len(painted.faces),
            "samples": result.samples,
            "hard_edge_samples": result.hard_edge_samples,
            "samples_per_kernel": round(result.samples_per_kernel, 2),
            "truncated_kernels": result.truncated,
        },
        spacing=result.spacing,
        noise=result.noise,
        change=_change(painted.colours, result.colours),
        stages=watch.stages,
        peak_memory=peak_memory(),
        written=files,
        warnings=warnings,
    )


def _change(before: NDArray[np.float32], after: NDArray[np.float32]) -> dict[str, float]:
    difference = np.abs(after - before)
    if not difference.size:
        return {"mean": 0.0, "rms": 0.0, "largest": 0.0}
    return {
        "mean": float(difference.mean(dtype=np.float64)),
        "rms": float(np.sqrt(np.mean(np.square(difference), dtype=np.float64))),
        "largest": float(difference.max()),
    }
