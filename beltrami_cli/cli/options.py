"""Every shared option once, with its help; defaults come from the settings record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import click

from beltrami_cli.flow.parameters import KernelParameters, Space, Units, Weights
from beltrami_cli.pipeline.settings import DEFAULTS, OUTPUT_FORMATS, SmoothSettings

if TYPE_CHECKING:
    from collections.abc import Callable

_KERNEL = DEFAULTS.kernel

iterations = click.option(
    "-n", "--iterations", type=int, default=_KERNEL.iterations, show_default=True, metavar="N",
    help="Kernel iterations; more smooth further. 0 leaves every byte as it is.",
)  # fmt: skip
time_step = click.option(
    "-t", "--time-step", "t", type=float, default=_KERNEL.t, show_default=True, metavar="T",
    help="Time step of an iteration: away from edges it is a Gaussian of variance 2T, in squared sample spacings.",
)  # fmt: skip
beta = click.option(
    "--beta", type=float, default=_KERNEL.beta, metavar="B",
    help="How strongly edges are kept: sample spacings per unit of colour (full scale 1). 0 is a plain Gaussian "
    "on the surface; 5 to 20 suits strong to slight noise.  [default: from the estimated noise]",
)  # fmt: skip
threshold = click.option(
    "--threshold", type=float, default=_KERNEL.threshold, show_default=True, metavar="K",
    help="Leave out samples whose kernel value is below K.",
)  # fmt: skip
weights = click.option(
    "--weights", type=click.Choice(get_args(Weights)), default=_KERNEL.weights, show_default=True,
    help="Count each sample once, or by the surface area that it stands for.",
)  # fmt: skip
units = click.option(
    "--units", type=click.Choice(get_args(Units)), default=_KERNEL.units, show_default=True,
    help="Unit of length of -t and --beta: the mean edge length, or that of the file.",
)  # fmt: skip
max_samples = click.option(
    "--max-samples", type=int, default=_KERNEL.max_samples, show_default=True, metavar="COUNT",
    help="Largest kernel; a guard against a time step that is too large. Warns when it takes effect.",
)  # fmt: skip
threads = click.option(
    "--threads", type=int, default=_KERNEL.threads, metavar="COUNT",
    help="Threads; the result does not depend on it.  [default: all processors]",
)  # fmt: skip
space = click.option(
    "--space", type=click.Choice(get_args(Space)), default=DEFAULTS.space, show_default=True,
    help="What colour distances and averages are taken in. 'data' takes the stored numbers as they are, for colours "
    "that stand for something else.",
)  # fmt: skip
channels = click.option(
    "--channels", metavar="LIST",
    help="Smooth only these channels, such as r,g; the others stay and do not count. Alpha always stays.",
)  # fmt: skip
overwrite = click.option("--overwrite", is_flag=True, help="Replace OUTPUT if it exists.")
output_format = click.option(
    "--format", "output_format", type=click.Choice(OUTPUT_FORMATS),
    help="Format of OUTPUT where its name does not tell, as with -.",
)  # fmt: skip
quiet = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
verbose = click.option(
    "-v", "--verbose", count=True, help="Print what is done; twice: also where an error arose."
)


def smoothing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that make up `SmoothSettings`."""
    for option in reversed(
        (iterations, time_step, beta, threshold, weights, units, space, channels, max_samples, threads)
    ):
        command = option(command)
    return command


def settings_from(options: dict[str, Any]) -> SmoothSettings:
    """Make the settings from the values of the options that `smoothing` adds.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    chosen = options["channels"]
    return SmoothSettings(
        kernel=KernelParameters(
            iterations=options["iterations"],
            t=options["t"],
            beta=options["beta"],
            threshold=options["threshold"],
            weights=options["weights"],
            units=options["units"],
            max_samples=options["max_samples"],
            threads=options["threads"],
        ),
        space=options["space"],
        channels=None
        if chosen is None
        else tuple(name.strip() for name in chosen.split(",") if name.strip()),
    )
