"""What is coloured in a file and how, and what smoothing it would do."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

from beltrami_cli.flow.iteration import BeltramiFlow
from beltrami_cli.formats.source import open_document
from beltrami_cli.mesh.topology import count_topology
from beltrami_cli.pipeline.settings import DEFAULTS, SmoothSettings
from beltrami_cli.pipeline.smooth_vertices import prepare, require_surface

if TYPE_CHECKING:
    from beltrami_cli.mesh.painted import PaintedVertices

# Enough for a mean within a few per cent, and a matter of milliseconds.
_PROBED_KERNELS = 1000


def inspect_file(source: str | os.PathLike[str], settings: SmoothSettings = DEFAULTS) -> dict[str, object]:
    """Describe a mesh file and what `smooth_file` would do with it.

    Parameters
    ----------
    source : path
        PLY, OBJ, glTF or GLB; "-" for standard input.
    settings : SmoothSettings
        What smoothing would be told.

    Returns
    -------
    dict
        JSON types only: "file" (facts of the format), "colours", "surface" (counts, spacing, bounds), "noise"
        (standard deviation per channel, full scale 1), "smooth" (parameters as they would be used, and the mean
        number of samples that a kernel of the first iteration would hold), "notices".

    Raises
    ------
    InputError
        If the source cannot be read or holds no vertex colours.
    UsageError
        If the settings contradict the file.
    """
    document = open_document(os.fspath(source))
    painted = document.painted()
    require_surface(painted, document.name)
    chosen, surface, sampling = prepare(painted, settings)
    flow = BeltramiFlow(surface, settings.kernel)
    joined = dataclasses.asdict(count_topology(surface.positions, surface.faces))
    return {
        "file": {"name": document.name, "format": document.format, **document.facts()},
        "colours": _describe_colours(painted),
        "surface": {
            "vertices": len(painted.positions),
            "triangles": len(painted.faces),
            "samples": len(surface.colours),
            "coincident_vertices": len(painted.positions) - sampling.places,
            "hard_edge_samples": len(surface.colours) - sampling.places,
            **joined,
            "mean_edge_length": flow.mean_edge_length,
            "bounds": _bounds(painted),
        },
        "noise": {painted.channels[i]: float(s) for i, s in zip(chosen, flow.sigma, strict=True)},
        "smooth": {
            **dataclasses.asdict(dataclasses.replace(settings.kernel, beta=flow.beta)),
            "threads": settings.kernel.thread_count,
            "space": settings.space,
            "samples_per_kernel": round(flow.probe_samples(_PROBED_KERNELS), 1),
        },
        "notices": list(document.notices),
    }


def _describe_colours(painted: PaintedVertices) -> dict[str, object]:
    colours = painted.colours
    return {
        "channels": list(painted.channels),
        "stored": painted.stored,
        "encoding": painted.encoding,
        "least": [float(value) for value in colours.min(axis=0)] if len(colours) else [],
        "greatest": [float(value) for value in colours.max(axis=0)] if len(colours) else [],
    }


def _bounds(painted: PaintedVertices) -> list[list[float]]:
    if not len(painted.positions):
        return []
    return [painted.positions.min(axis=0).tolist(), painted.positions.max(axis=0).tolist()]
