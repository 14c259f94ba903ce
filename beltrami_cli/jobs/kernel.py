"""Write one kernel of a file: as a mesh or a picture to be looked at, or as numbers.

Bright is near and weighs much, dark is where the kernel ends, grey is beyond.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Uint8s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.records import SampledKernel
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.ply.writer import write_scalars_as_ply
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.output import Output
from beltrami_cli.jobs.recolour import open_input
from beltrami_cli.samples.memory_check import require_memory_for_textures
from beltrami_cli.samples.probes.probe import Location, MeshView, Probe, WindowView, read_location
from beltrami_cli.samples.selection import require_scale, samples_of, select
from beltrami_cli.samples.settings import DEFAULTS, IMAGE_SUFFIXES, SmoothSettings
from beltrami_cli.surface.colour_values import as_bytes, colour_by_value

_TABLES = (".csv", ".json", ".npz")
SUFFIXES = (".ply", *IMAGE_SUFFIXES, *_TABLES)
_NOTHING = 1.0  # where there is no sample
_PANEL, _GAP = 420, 12  # pixels
_SOURCE = np.array([0.9, 0.1, 0.1])


def _as_table(facts: dict[str, Any], columns: dict[str, Array], suffix: str) -> bytes:
    if suffix == ".csv":
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
        return text.getvalue().encode()
    if suffix == ".json":
        listed = {name: values.tolist() for name, values in columns.items()}
        return (json.dumps({**facts, "columns": listed}, indent=2) + "\n").encode()
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, facts=json.dumps(facts), **columns)
    return buffer.getvalue()


def _drawn(facts: dict[str, Any], view: MeshView | WindowView, suffix: str) -> Written:
    drawn_as = ".ply" if isinstance(view, MeshView) else ".png"
    if (drawn_as == ".ply") != (suffix == ".ply"):
        raise UsageError(
            f"{facts['output']}: the kernel of a {facts['at'].split()[0]} is drawn as {drawn_as}, or written as "
            f"{', '.join(_TABLES)}"
        )
    if isinstance(view, MeshView):
        return _mesh(view, facts)
    pixels = _picture(view, facts["radius"])
    return Written([write_image(new_picture(pixels, facts["output"]), pixels, suffix=suffix).data])


def _mesh(view: MeshView, facts: dict[str, Any]) -> Written:
    nearness = _nearness(view, facts["radius"])
    shades = as_bytes(colour_by_value(nearness, view.shades, np.isfinite(view.distances)))
    scalars = {"distance": view.distances, "weight": view.weights}
    comments = [f"kernel of {facts['at']}, beta {facts['beta']:.6g}, t {facts['t']:.6g}"]
    return write_scalars_as_ply(view.positions, view.faces, shades, scalars, comments)


def _nearness(view: MeshView | WindowView, radius: float) -> Float32s:
    """Return 1 at the kernel's own sample, falling to 0 at the radius; NaN where the kernel holds nothing."""
    reach = max(np.float32(radius), np.finfo(np.float32).tiny)
    return np.asarray(1 - view.distances / reach, np.float32)


def _picture(view: WindowView, radius: float) -> Uint8s:
    """Draw a window three times side by side: the painting, the distances, the weights."""
    held = np.isfinite(view.distances)
    panels = (
        view.shades.astype(np.float64),
        colour_by_value(_nearness(view, radius), view.shades, held),
        colour_by_value(view.weights / view.weights.max(), view.shades, held),
    )
    zoom = max(1, _PANEL // len(view.filled))
    shown = [np.where(view.filled[..., None], panel, _NOTHING) for panel in panels]
    drawn = [panel.repeat(zoom, axis=0).repeat(zoom, axis=1) for panel in shown]
    if zoom > 2:
        thickness = max(1, zoom // 14)
        row, column = (zoom * index for index in view.source)
        for panel in drawn:
            square = panel[row : row + zoom, column : column + zoom]
            inside = square[thickness:-thickness, thickness:-thickness].copy()
            square[:] = _SOURCE
            square[thickness:-thickness, thickness:-thickness] = inside
    gap = np.full((len(drawn[0]), _GAP, 3), _NOTHING)
    return as_bytes(np.hstack([drawn[0], gap, drawn[1], gap, drawn[2]]))


def kernel_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    at: str,
    settings: SmoothSettings = DEFAULTS,
    *,
    iteration: int = 1,
    whole: bool = False,
    job: Job = PLAIN_JOB,
) -> dict[str, Any]:
    """Write the geodesic distances and the weights of the kernel at a sample, in an iteration; return its facts."""
    source, target = os.fspath(source), os.fspath(target)
    if iteration < 1:
        raise UsageError(f"iteration is {iteration}, but must be 1 or more")
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix not in SUFFIXES:
        message = f"{target}: a kernel is written as .ply, .png, .csv, .json or .npz; end the name in one"
        raise UsageError(message)
    location = read_location(at)
    output = Output(target, overwrite=job.overwrite, is_text=suffix == ".csv", what="kernel", reads=[source])
    access = output.files.watching(job.access)
    document = open_input(source, settings, access)
    selection = select(document, settings)
    require_scale(document, selection)
    if selection.vertices + len(selection.slots) + selection.image > 1:
        remedy = "choose --on vertices, or --on texture and one of --slots"
        raise UsageError(f"{document.name}: a kernel is of one image; {remedy}")
    require_memory_for_textures(document, selection.slots, settings.textures, access)
    (samples,) = samples_of(document, selection, settings, access)
    probe = samples.probe(document, whole=whole)
    kernel, found = _kernel(probe, location, iteration - 1, job.progress_of("iterations before"))
    facts = {"input": source, "output": target, **found}
    if suffix not in _TABLES:
        output.write(_drawn(facts, probe.view(kernel), suffix))
        return facts
    # For each sample: which it is, distance, weight, colour.
    columns = probe.columns(kernel.samples) | {"distance": kernel.distances, "weight": kernel.weights}
    columns |= dict(zip(probe.colours.names, kernel.colours.T, strict=True))
    output.write(Written([_as_table(facts, columns, suffix)]))
    return facts


def _kernel(
    probe: Probe, location: Location, iteration: int, progress: Callable[[int, int], None] | None
) -> tuple[SampledKernel, dict[str, Any]]:
    """Run the iterations before one, counted from 0; return the kernel of a sample in that, and facts in JSON types."""
    sample, facts = probe.find(location)
    iterations = probe.flow.parameters.iterations
    # What is restored of clipped colours comes after the averages of all iterations, and is none of them.
    probe.flow.stop_before(iteration)
    parameters = probe.flow.parameters
    probe.flow.run(progress)
    kernel = probe.flow.kernel_at(sample)
    units = {"spacing": "sample spacing", "world": "that of the file"}
    names = probe.colours.names
    facts |= probe.facts(kernel)
    return kernel, facts | {
        "iteration": iteration + 1,
        "iterations": iterations,
        "regularised_metric": parameters.is_regularised(iteration),
        "t": parameters.t,
        "first_beta": probe.flow.beta,
        "beta": probe.flow.beta * parameters.growth(iteration),
        "threshold": parameters.threshold,
        "unit_of_length": probe.unit or units[parameters.units],
        "radius": parameters.radius,
        "space": probe.colours.space,
        "samples": len(kernel.samples),
        "furthest": float(kernel.distances.max()),
        "sum_of_weights": float(kernel.weights.sum(dtype=np.float64)),
        "before": dict(zip(names, kernel.colours[0].tolist(), strict=True)),
        "after": dict(zip(names, kernel.mean.tolist(), strict=True)),
    }
