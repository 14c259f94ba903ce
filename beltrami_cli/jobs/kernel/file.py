"""Write the kernel of one sample of a file: drawn on the mesh or in an image, or as a table."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.manifolds.iteration import SampledKernel
from beltrami_cli.flow.parameters import growth_at
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.kernel.drawing import draw_in_image, draw_on_mesh
from beltrami_cli.jobs.kernel.places import Place, place_at
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.layer import Layer, SampledVertices
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import DEFAULTS, IMAGE_SUFFIXES, SmoothSettings


@dataclass(frozen=True)
class ShownKernel:
    """The kernel of one sample in one iteration; `table` has a row for each sample that it holds, the nearest first."""

    at: str  # the name of its place
    iterations: int
    beta: float
    radius: float
    cut_short: bool  # at max_samples
    table: dict[str, Array]  # which sample it is, its distance, weight, and colour in the working space


def kernel_file(
    source: str | os.PathLike[str], target: str | os.PathLike[str], at: str, settings: SmoothSettings = DEFAULTS,
    *, iteration: int = 1, job: Job = PLAIN_JOB,
) -> ShownKernel:  # fmt: skip
    """Write the kernel of the sample at a place, in an iteration counted from 1, as .ply, image or .csv."""
    source, target = os.fspath(source), os.fspath(target)
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix not in (".ply", ".csv", *IMAGE_SUFFIXES):
        raise UsageError("a kernel is written as .ply, .png or .csv; end the name in one", target)
    output = Output(target, overwrite=job.overwrite, is_text=suffix == ".csv", what="kernel", reads=[source])
    document, layer = _only_layer(source, settings, output.files.watching(job.access))
    samples = layer.places()
    vertices = samples if isinstance(samples, SampledVertices) else None
    if suffix != ".csv" and (suffix == ".ply") != (vertices is not None):
        drawn_as = ".png" if vertices is None else ".ply"
        raise UsageError(f"a kernel on {layer.label} is drawn as {drawn_as}, or written as .csv", target)
    plan = layer.plan()
    parameters = plan.parameters
    if iteration > max(parameters.iterations, 1):
        cause = f"--iteration {iteration} is not among the {parameters.iterations} of smoothing"
        raise UsageError(f"{cause}; lower it, or raise --iterations")
    place = place_at(at, samples, document, layer.label)
    earlier = plan.stopped_before(iteration - 1)
    manifold = smooth_in_place(earlier, job.progress_of("iterations before")).manifold
    kernel = manifold.kernel_at(place.sample, plan.step(iteration - 1))
    table = _table(kernel, place, layer)
    nearness = 1 - kernel.distances / max(np.float32(parameters.radius), np.finfo(np.float32).tiny)
    if suffix == ".csv":
        written = _csv(table)
    elif vertices is not None:
        written = draw_on_mesh(vertices, manifold.new_colours().table(), kernel, nearness, layer)
    else:
        written = draw_in_image(manifold, place.sample, kernel, nearness, layer, suffix)
    output.write(written)
    beta = plan.beta / layer.unit * growth_at(iteration - 1, parameters.beta_growth)
    cut_short = vertices is not None and len(kernel.samples) == parameters.max_samples
    return ShownKernel(place.name, parameters.iterations, beta, parameters.radius, cut_short, table)


def _only_layer(source: str, settings: SmoothSettings, access: Access) -> tuple[Document, Layer]:
    """Open a file, and return it and its selected layer; UsageError if there are several."""
    document = open_input(source, settings, access)
    selection = select(document, settings)
    selection.require_scale()
    if selection.vertices + len(selection.slots) + selection.image > 1:
        remedy = "choose --on vertices, or --on texture and one of --slots"
        raise UsageError(f"a kernel is of one image; {remedy}", document.name)
    selection.require_memory("smoothed" if selection.image else "recoloured")
    (layer,) = selection.layers()
    return document, layer.normalised()


def _table(kernel: SampledKernel, place: Place, layer: Layer) -> dict[str, Array]:
    table = {column: values[kernel.samples] for column, values in place.columns.items()}
    table |= {"distance": kernel.distances, "weight": kernel.weights}
    channels = ("L", "a", "b", *layer.names[3:]) if layer.settings.space == "oklab" else layer.names
    return table | dict(zip(channels, layer.unit * kernel.colours.T, strict=True))


def _csv(table: dict[str, Array]) -> Written:
    text = io.StringIO()
    rows = zip(*(values.tolist() for values in table.values()), strict=True)
    csv.writer(text, lineterminator="\n").writerows([list(table), *rows])
    return Written([text.getvalue().encode()])
