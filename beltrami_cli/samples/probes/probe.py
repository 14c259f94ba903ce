"""Samples of one kind, and what a kernel on them needs to be found, named and drawn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.colour_space import from_space

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.manifold import SampledKernel
    from beltrami_cli.flow.parameters import Space
    from beltrami_cli.samples.probes.location import Location

_COLOURS = ("red", "green", "blue", "grey")


@dataclass(frozen=True)
class MeshView:
    """The part of a mesh, of V vertices, that a kernel is shown on."""

    positions: Float64s
    faces: Int32s
    shades: Float32s  # (V, 3): the painting, as display values in [0, 1]
    distances: Float32s  # NaN where the kernel holds nothing
    weights: Float32s  # 0 there


@dataclass(frozen=True)
class WindowView:
    """The part of a canvas, of H x W cells, that a kernel is shown on."""

    shades: Float32s  # (H, W, 3): the painting, as display values in [0, 1]
    filled: Bools  # cells that hold a colour
    distances: Float32s  # NaN where the kernel holds nothing
    weights: Float32s  # 0 there
    source: tuple[int, int]  # row and column of the kernel's own cell


@dataclass(frozen=True)
class WorkingColours:
    """What the columns of colours in the working space mean."""

    channels: tuple[str, ...]
    space: Space

    @property
    def names(self) -> tuple[str, ...]:
        return ("L", "a", "b", *self.channels[3:]) if self.space == "oklab" else self.channels

    def shades(self, colours: Float32s) -> Float32s:
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


@dataclass
class Probe(ABC):
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
    def columns(self, samples: Int64s) -> dict[str, Array]:
        """Return what the samples of a kernel are, by the names of columns."""

    @abstractmethod
    def view(self, kernel: SampledKernel) -> MeshView | WindowView:
        """Cut out what lies around a kernel."""
