"""What one kernel is like, as facts and a table, with what is needed to draw it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.colour_space import from_space

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.kernel_probe import SampledKernel
    from beltrami_cli.flow.parameters import KernelParameters, Space

_COLOURS = ("red", "green", "blue", "grey")


@dataclass(frozen=True)
class MeshView:
    """The part of a mesh that a kernel is shown on.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Vertices.
    faces : ndarray of int32, shape (F, 3)
        Triangles.
    shades : ndarray of float32, shape (V, 3)
        The painting, as display values in [0, 1].
    distances, weights : ndarray of float32, shape (V,)
        Of the kernel; NaN and 0 at vertices that it does not hold.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    shades: NDArray[np.float32]
    distances: NDArray[np.float32]
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class WindowView:
    """The part of a canvas that a kernel is shown on, of H x W cells.

    Attributes
    ----------
    shades : ndarray of float32, shape (H, W, 3)
        The painting, as display values in [0, 1].
    filled : ndarray of bool, shape (H, W)
        Cells that hold a colour.
    distances, weights : ndarray of float32, shape (H, W)
        Of the kernel; NaN and 0 at cells that it does not hold.
    source : (int, int)
        Row and column of the kernel's own cell.
    """

    shades: NDArray[np.float32]
    filled: NDArray[np.bool_]
    distances: NDArray[np.float32]
    weights: NDArray[np.float32]
    source: tuple[int, int]


@dataclass(frozen=True)
class KernelStudy:
    """One kernel.

    Attributes
    ----------
    facts : dict
        Parameters as used, counts, and the sample's colour before and after the iteration, in JSON types.
    columns : dict of str to ndarray, each of shape (K,)
        For each sample that the kernel holds: which it is, its distance, its weight and its colour.
    radius : float
        The distance at which kernels end.
    view : MeshView or WindowView
        What to draw.
    """

    facts: dict[str, object]
    columns: dict[str, NDArray[np.generic]]
    radius: float
    view: MeshView | WindowView


@dataclass(frozen=True)
class Shown:
    """What the columns of working colours mean.

    Attributes
    ----------
    channels : tuple of str
        The channels that were chosen.
    space : {"srgb", "linear", "oklab", "data"}
        The space that they are in.
    """

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


def describe(
    kernel: SampledKernel, shown: Shown, parameters: KernelParameters, beta: float, unit: str = ""
) -> dict[str, object]:
    """Return the facts of a kernel that do not depend on what it is on; `unit`: of length, if it is another."""
    unit = unit or ("sample spacing" if parameters.units == "spacing" else "that of the file")
    return {
        "iteration": parameters.iterations + 1,
        "regularised_metric": parameters.is_regularised(parameters.iterations),
        "t": parameters.t,
        "beta": beta * parameters.growth(parameters.iterations),
        "threshold": parameters.threshold,
        "unit_of_length": unit,
        "radius": parameters.radius,
        "space": shown.space,
        "samples": len(kernel.samples),
        "furthest": float(kernel.distances.max()),
        "sum_of_weights": float(kernel.weights.sum(dtype=np.float64)),
        "before": dict(zip(shown.names, kernel.colours[0].tolist(), strict=True)),
        "after": dict(zip(shown.names, kernel.mean.tolist(), strict=True)),
    }


def table(kernel: SampledKernel, shown: Shown) -> dict[str, NDArray[np.generic]]:
    """Return the columns of a kernel that do not depend on what it is on."""
    colours = {name: kernel.colours[:, i] for i, name in enumerate(shown.names)}
    return {"distance": kernel.distances, "weight": kernel.weights, **colours}
