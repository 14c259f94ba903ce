"""Put together the record of a job from what its parts found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.jobs.smooth.report import SmoothReport, VertexReport
from beltrami_cli.jobs.smooth.stopwatch import peak_memory
from beltrami_cli.samples.change import Change
from beltrami_cli.samples.settings import describe_choice, describe_settings

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.smooth.report import ImageReport
    from beltrami_cli.jobs.smooth.stopwatch import Stopwatch
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.samples.textures.smooth import SlotReport
    from beltrami_cli.samples.vertices.result import SmoothResult
    from beltrami_cli.surface.records import PaintedVertices


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
        parameters=describe_settings(settings),
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
        outliers = vertices.cloud.outliers
        alone = "is left as it is: it is" if outliers == 1 else "are left as they are: they are"
        where = "too far from others, in one line with them, or nowhere"
        warnings = [*warnings, f"{outliers} of {len(vertices.colours)} points {alone} {where}"]
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
        parameters=describe_settings(settings),
        vertices=None if vertices is None else _vertex_report(document, vertices),
        textures=slots,
        stages=watch.stages,
        peak_memory=peak_memory(),
        written=files,
        warnings=warnings,
    )


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
