"""One kernel of one iteration, to be looked at: geodesic distances on the image manifold, and the weights they give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.cell_fields import CellFields
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# The paper's scheme takes supports up to ten cells away, and the metric from the cells beside them.
_BEYOND_WINDOW = 12


@dataclass(frozen=True)
class SampledKernel:
    """The K samples that the kernel of one sample p holds, p first and the others by their distance.

    Attributes
    ----------
    samples : ndarray of int64, shape (K,)
        Which samples: of a surface, or cells (flat indices) of an atlas's canvas.
    distances : ndarray of float32, shape (K,)
        d(p, q), in the unit of length of the parameters; 0 at p.
    weights : ndarray of float32, shape (K,)
        w_q exp(-d(p, q)^2 / (4 t)), eqs. (8, 9), not yet divided by their sum.
    colours : ndarray of float32, shape (K, N)
        I(q), before the iteration, in the working space.
    """

    samples: NDArray[np.int64]
    distances: NDArray[np.float32]
    weights: NDArray[np.float32]
    colours: NDArray[np.float32]

    @property
    def mean(self) -> NDArray[np.float64]:
        """The colour that the iteration gives p, shape (N,): sum w I / sum w."""
        weights = self.weights.astype(np.float64)
        if not weights.any():  # a sample that stands for no area, alone
            return np.asarray(self.colours[0], np.float64)
        return np.asarray(np.average(self.colours, axis=0, weights=weights), np.float64)


def kernel_values(distances: NDArray[np.float32], t: float) -> NDArray[np.float32]:
    """Return exp(-d^2 / (4 t)), eq. (8)."""
    return np.asarray(np.exp(-np.square(distances.astype(np.float64)) / (4 * t)), np.float32)


def kernel_on_grid(
    atlas: Atlas,
    fields: CellFields,
    metric: NDArray[np.float32],
    planes: NDArray[np.float32],
    beta: float,
    parameters: KernelParameters,
    cell: int,
) -> SampledKernel:
    """Take the kernel of one owned cell out of a canvas.

    Parameters
    ----------
    atlas : Atlas
        The canvas of R x C cells.
    fields : CellFields
        Of the canvas.
    metric, planes : ndarray of float32, shape (N, R, C)
        Colours that distances are taken from, and colours that are averaged.
    beta : float
        Units of length per unit of colour of `metric`.
    parameters : KernelParameters
        t, threshold, window and scheme.
    cell : int
        Flat index of an OWNED cell.

    Returns
    -------
    SampledKernel
    """
    from beltrami_cli._native import grid_distances
    from beltrami_cli.flow.canvas import scheme_of

    columns, reach = atlas.kind.shape[1], parameters.window // 2
    row, column = divmod(cell, columns)
    # Nothing further away has an effect, and stencils of a whole canvas take long.
    top, left = max(0, row - reach - _BEYOND_WINDOW), max(0, column - reach - _BEYOND_WINDOW)
    rows, across = (
        slice(top, row + reach + _BEYOND_WINDOW + 1),
        slice(left, column + reach + _BEYOND_WINDOW + 1),
    )
    kind = np.ascontiguousarray(atlas.kind[rows, across])
    window = grid_distances(
        kind,
        np.ascontiguousarray(atlas.squared_lengths[:, rows, across]),
        None if fields.scale is None else np.ascontiguousarray(fields.scale[rows, across]),
        np.ascontiguousarray(metric[:, rows, across]),
        beta,
        parameters.radius,
        reach,
        scheme_of(parameters),
        0,
        (row - top) * kind.shape[1] + column - left,
    )
    y, x = np.nonzero(np.isfinite(window))
    order = np.argsort(window[y, x], kind="stable")
    y, x = y[order], x[order]
    cells = (row + y - reach) * columns + column + x - reach
    # Samples at one place have the distance 0 too.
    first = np.argsort(cells != cell, kind="stable")
    distances, cells = window[y, x][first], cells[first]
    weights = kernel_values(distances, parameters.t)
    if fields.repeats is not None:
        weights /= fields.repeats.reshape(-1)[cells]
    return SampledKernel(
        cells.astype(np.int64),
        distances,
        weights,
        np.ascontiguousarray(planes.reshape(len(planes), -1)[:, cells].T),
    )
