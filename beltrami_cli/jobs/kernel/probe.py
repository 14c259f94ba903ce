"""One kernel of any kind of samples: its facts, its samples as a table, and what to draw of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.colour_space import from_space
from beltrami_cli.jobs.kernel.output import ProbedKernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.manifold import SampledKernel
    from beltrami_cli.flow.parameters import KernelParameters, Space
    from beltrami_cli.jobs.kernel.location import Location
    from beltrami_cli.jobs.kernel.output import MeshView, WindowView

_COLOURS = ("red", "green", "blue", "grey")


@dataclass(frozen=True)
class WorkingColours:
    """What the columns of colours in the working space mean."""

    channels: tuple[str, ...]
    space: Space

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return ("L", "a", "b", *self.channels[3:]) if self.space == "oklab" else self.channels

    def shades(self, colours: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return colours, shape (S, N), as display values of red, green and blue in [0, 1]; other data are grey."""
        coloured = [i for i, channel in enumerate(self.channels) if channel in _COLOURS]
        if coloured:
            shades = from_space(colours[:, coloured], "srgb", self.space)
        else:  # data alone, whose numbers may have any range
            low, high = colours[:, 0].min(), colours[:, 0].max()
            shades = (colours[:, :1] - low) / max(high - low, np.float32(1e-30))
        if shades.shape[1] != 3:
            shades = np.repeat(shades.mean(axis=1, keepdims=True), 3, axis=1)
        return np.clip(shades, 0, 1)


class ProbedSamples(ABC):
    """Samples of one kind, and what a kernel on them needs to be found, named and drawn."""

    flow: BeltramiFlow[Any]
    colours: WorkingColours
    unit = ""  # of length, where the parameters do not say it

    @abstractmethod
    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        """Return the sample that the user means, as the flow numbers it, and what it is; UsageError if none."""

    def facts(self, kernel: SampledKernel) -> dict[str, object]:
        """Return what else is known of a kernel on samples of this kind."""
        del kernel
        return {}

    @abstractmethod
    def columns(self, samples: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Return what the samples of a kernel are, by the names of columns."""

    @abstractmethod
    def view(self, kernel: SampledKernel) -> MeshView | WindowView:
        """Cut out what lies around a kernel."""


def probe_kernel(
    samples: ProbedSamples,
    location: Location,
    parameters: KernelParameters,
    progress: Callable[[int, int], None] | None,
) -> ProbedKernel:
    """Run the iterations, and take the kernel of the sample at a location after them."""
    sample, facts = samples.find(location)
    samples.flow.run(progress)
    kernel = samples.flow.kernel_at(sample)
    names = samples.colours.names
    colours = {name: kernel.colours[:, i] for i, name in enumerate(names)}
    facts |= samples.facts(kernel)
    facts |= {
        "iteration": parameters.iterations + 1,
        "regularised_metric": parameters.is_regularised(parameters.iterations),
        "t": parameters.t,
        "beta": samples.flow.beta * parameters.growth(parameters.iterations),
        "threshold": parameters.threshold,
        "unit_of_length": samples.unit or _unit(parameters),
        "radius": parameters.radius,
        "space": samples.colours.space,
        "samples": len(kernel.samples),
        "furthest": float(kernel.distances.max()),
        "sum_of_weights": float(kernel.weights.sum(dtype=np.float64)),
        "before": dict(zip(names, kernel.colours[0].tolist(), strict=True)),
        "after": dict(zip(names, kernel.mean.tolist(), strict=True)),
    }
    columns = samples.columns(kernel.samples)
    columns |= {"distance": kernel.distances, "weight": kernel.weights, **colours}
    return ProbedKernel(facts, columns, parameters.radius, samples.view(kernel))


def _unit(parameters: KernelParameters) -> str:
    return "sample spacing" if parameters.units == "spacing" else "that of the file"
