"""The options of the kernel, and its parameters from their values."""

from __future__ import annotations

from typing import Any, get_args

import click
from click.core import ParameterSource

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import (
    PRESETS,
    Clipping,
    KernelParameters,
    Solver,
    Strength,
    Units,
    Weights,
    parameters_with,
)
from beltrami_cli.samples.settings import DEFAULTS

_KERNEL = DEFAULTS.kernel

# A Gaussian of a smaller standard deviation, in sample spacings, has no weight beyond its own sample.
SMALLEST_SCALE = 0.05

iterations = click.option(
    "-n", "--iterations", type=click.IntRange(0), metavar="N",
    help="Kernel iterations; more smooth further. 0 leaves every byte as it is.  [default: chosen from the data]",
)  # fmt: skip
time_step = click.option(
    "-t", "--time-step", "t", type=float, metavar="T",
    help="Time step of an iteration: away from edges it is a Gaussian of variance 2T, in squared sample spacings. "
    "On textures and images the window bounds the kernel, so that it is this Gaussian only if the window holds it: "
    "raise --window for a large T.  [default: chosen from the data]",
)  # fmt: skip
beta = click.option(
    "--beta", type=float, default=_KERNEL.beta, metavar="B",
    help="How strongly edges are kept: sample spacings per unit of colour (full scale 1). 0 is a plain Gaussian "
    "on the surface; 5 to 40 suits strong to slight noise.  [default: chosen from the data]",
)  # fmt: skip
beta_growth = click.option(
    "--beta-growth", type=float, metavar="G",
    help="Multiply beta by G from one iteration to the next: as less noise is left, finer edges count.  [default: "
    "chosen from the data]",
)  # fmt: skip
clipping = click.option(
    "--clipping", type=click.Choice(get_args(Clipping)), default=_KERNEL.clipping, show_default=True,
    help="Where noise was cut off at 0 or full scale, averages are too bright or too dark: restore what they would be "
    "without, or keep them.",
)  # fmt: skip
threshold = click.option(
    "--threshold", type=float, default=_KERNEL.threshold, show_default=True, metavar="K",
    help="Leave out samples whose kernel value is below K.",
)  # fmt: skip
metric_scale = click.option(
    "--metric-scale", type=float, default=_KERNEL.metric_scale, show_default=True, metavar="S",
    help="Take distances from colours smoothed over S sample spacings, so that noise does not make them; the colours "
    "themselves are averaged. 0: never.",
)  # fmt: skip
metric_steps = click.option(
    "--metric-steps", type=click.IntRange(0), metavar="K",
    help="Do so in the first K iterations; the others take distances from the colours as they are.  [default: chosen "
    "from the data]",
)  # fmt: skip
strength = click.option(
    "--strength", type=click.Choice(get_args(Strength)), default=_KERNEL.strength, show_default=True,
    help="Smooth less or more than what is estimated to be closest to the colours without noise. It moves only what is "
    "not given.",
)  # fmt: skip
fast = click.option(
    "--fast", is_flag=True,
    help="Try nothing: what is not given follows a fixed rule for the noise. It takes no time, and results are some "
    "0.2 dB worse on vertices, and 1.1 dB on textures and images. With --beta 0, --preset and --smooth-geometry "
    f"nothing is tried either: there it is -n {_KERNEL.iterations}, -t {_KERNEL.t:g}, --beta-growth "
    f"{_KERNEL.beta_growth:g}, --metric-steps {_KERNEL.metric_steps}.",
)  # fmt: skip
preset = click.option(
    "--preset", type=click.Choice(sorted(PRESETS)),
    help="Parameters as a set, which single options still override. 'paper' is the paper's kernel to the letter: "
    "one iteration, t 0.5, threshold 0.01, a window of 7, on textures and images its parametric fast marching.",
)  # fmt: skip
weights = click.option(
    "--weights", type=click.Choice(get_args(Weights)), default=_KERNEL.weights, show_default=True,
    help="On vertices: count each sample once, or by the surface area that it stands for.",
)  # fmt: skip
units = click.option(
    "--units", type=click.Choice(get_args(Units)), default=_KERNEL.units, show_default=True,
    help="Unit of length of -t and --beta: the local sample spacing, or that of the file, which needs -t. On images, "
    "with or without --height, it is the pixel.",
)  # fmt: skip
max_samples = click.option(
    "--max-samples", type=click.IntRange(1, 2**31 - 1), default=_KERNEL.max_samples, show_default=True, metavar="COUNT",
    help="On vertices: the largest kernel, a guard against a time step that is too large. Warns when it takes effect.",
)  # fmt: skip
solver = click.option(
    "--solver", type=click.Choice(get_args(Solver)), default=_KERNEL.solver, show_default=True,
    help="On vertices: find distances by fast marching, or along straight segments over edges and over one or two "
    "unfolded edges, which is several times faster and closer to the truth. auto takes segments for kernels of a "
    "radius of up to 14 sample spacings (-t below 10), where that is so, and fast marching for larger ones.",
)  # fmt: skip
threads = click.option(
    "--threads", type=click.IntRange(1, 1024), default=_KERNEL.threads, metavar="COUNT",
    help="Threads; the result does not depend on it.  [default: all processors]",
)  # fmt: skip
window = click.option(
    "--window", type=click.IntRange(3, 255), default=_KERNEL.window, show_default=True, metavar="W",
    help="On textures and images: side of the square in which a kernel is looked for, odd, 3 to 15; wider ones are "
    "slow.",
)  # fmt: skip

# Where the value of an option can come from that is not its default.
_BY_DIRECTNESS = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP)

# Options that are parameters of the kernel, under the names that they have there.
_KERNEL_OPTIONS = (
    "iterations", "t", "beta", "beta_growth", "threshold", "weights", "units", "max_samples", "threads", "window",
    "metric_scale", "metric_steps", "clipping", "solver", "strength",
)  # fmt: skip


def kernel_from(options: dict[str, Any]) -> KernelParameters:
    """Make the parameters of the kernel from the values of its options; UsageError if one is out of its range."""
    values: dict[str, Any] = dict(PRESETS[options["preset"]]) if options["preset"] else {}
    for name in _KERNEL_OPTIONS:
        if is_given(name) or name not in values:
            values[name] = options[name]
    if values["units"] == "world" and not is_given("t"):
        raise UsageError("--units world needs -t, in squared units of the file")
    if 0 < values["metric_scale"] < SMALLEST_SCALE:
        scale = values["metric_scale"]
        raise UsageError(f"metric_scale is {scale}, but must be 0, or between {SMALLEST_SCALE} and 3")
    return parameters_with(values, choose=not options["preset"], fast=options["fast"])


def is_given(name: str) -> bool:
    """Tell whether an option was given: on the command line, by a variable of the environment, or in a file.

    What a preset says counts for more than what was given less directly than the preset.
    """
    context = click.get_current_context()
    source, preset = context.get_parameter_source(name), context.get_parameter_source("preset")
    if source not in _BY_DIRECTNESS:
        return False
    if name not in PRESETS.get(context.params.get("preset") or "", {}) or preset not in _BY_DIRECTNESS:
        return True
    return _BY_DIRECTNESS.index(source) <= _BY_DIRECTNESS.index(preset)
