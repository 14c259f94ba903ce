"""Write one kernel of a file, to be looked at or as numbers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.jobs.documents import open_input
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.kernel.output import SUFFIXES, ProbedKernel, encode
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_memory_for_textures
from beltrami_cli.samples.probes.location import read_location
from beltrami_cli.samples.selection import require_scale, samples_of, select
from beltrami_cli.samples.settings import DEFAULTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.formats.access import Access
    from beltrami_cli.samples.probes.location import Location
    from beltrami_cli.samples.probes.probe import Probe
    from beltrami_cli.samples.settings import SmoothSettings


def kernel_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    at: str,
    settings: SmoothSettings = DEFAULTS,
    *,
    iteration: int = 1,
    whole: bool = False,
    job: Job = PLAIN_JOB,
) -> dict[str, object]:
    """Write the geodesic distances and the weights of the kernel at a sample, in an iteration; return its facts."""
    source, target = os.fspath(source), os.fspath(target)
    if iteration < 1:
        raise UsageError(f"iteration is {iteration}, but must be 1 or more")
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(
            f"{target}: a kernel is written as .ply, .png, .csv, .json or .npz; end the name in one"
        )
    location = read_location(at)
    output = Output(target, overwrite=job.overwrite, is_text=suffix == ".csv", what="kernel", reads=[source])
    access = output.files.watching(job.access)
    probe = _probe_of(source, settings, access, whole=whole)
    probed = _kernel(probe, location, iteration - 1, job.progress_of("iterations before"))
    facts = {"input": source, "output": target, **probed.facts}
    output.write(encode(probed, facts, suffix))
    return facts


def _probe_of(source: str, settings: SmoothSettings, access: Access, *, whole: bool) -> Probe:
    document = open_input(source, settings, access)
    selection = select(document, settings)
    require_scale(document, selection)
    if selection.vertices + len(selection.slots) + selection.image > 1:
        raise UsageError(
            f"{document.name}: a kernel is of one image; choose --on vertices, or --on texture and one of --slots"
        )
    require_memory_for_textures(document, selection.slots, settings.textures, access)
    (samples,) = samples_of(document, selection, settings, access)
    return samples.probe(document, whole=whole)


def _kernel(
    probe: Probe,
    location: Location,
    iteration: int,
    progress: Callable[[int, int], None] | None,
) -> ProbedKernel:
    """Run the iterations before one, counted from 0, and take the kernel of the sample at a location in that."""
    sample, facts = probe.find(location)
    iterations = probe.flow.parameters.iterations
    # What is restored of clipped colours comes after the averages of all iterations, and is none of them.
    probe.flow.stop_before(iteration)
    parameters = probe.flow.parameters
    probe.flow.run(progress)
    kernel = probe.flow.kernel_at(sample)
    names = probe.colours.names
    colours = {name: kernel.colours[:, i] for i, name in enumerate(names)}
    facts |= probe.facts(kernel)
    facts |= {
        "iteration": iteration + 1,
        "iterations": iterations,
        "regularised_metric": parameters.is_regularised(iteration),
        "t": parameters.t,
        "first_beta": probe.flow.beta,
        "beta": probe.flow.beta * parameters.growth(iteration),
        "threshold": parameters.threshold,
        "unit_of_length": probe.unit or _unit(parameters),
        "radius": parameters.radius,
        "space": probe.colours.space,
        "samples": len(kernel.samples),
        "furthest": float(kernel.distances.max()),
        "sum_of_weights": float(kernel.weights.sum(dtype=np.float64)),
        "before": dict(zip(names, kernel.colours[0].tolist(), strict=True)),
        "after": dict(zip(names, kernel.mean.tolist(), strict=True)),
    }
    columns = probe.columns(kernel.samples)
    columns |= {"distance": kernel.distances, "weight": kernel.weights, **colours}
    return ProbedKernel(facts, columns, parameters.radius, probe.view(kernel))


def _unit(parameters: KernelParameters) -> str:
    return "sample spacing" if parameters.units == "spacing" else "that of the file"
