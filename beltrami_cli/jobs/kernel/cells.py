"""The kernel of a cell of a canvas: of a texel, or of a pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.jobs.kernel.study import KernelStudy, Shown, WindowView, describe, table
from beltrami_cli.surface.atlas import EMPTY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.grid_manifold import GridManifold
    from beltrami_cli.flow.kernel_probe import SampledKernel
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# Cells around the window that are shown at least.
_LEAST_SURROUNDINGS = 4


def study_cell(
    flow: BeltramiFlow[GridManifold],
    kernel: SampledKernel,
    shown: Shown,
    parameters: KernelParameters,
    facts: dict[str, object],
    columns: dict[str, NDArray[np.generic]],
    unit: str = "",
) -> KernelStudy:
    """Put together what is known of a kernel on a canvas.

    Parameters
    ----------
    flow : BeltramiFlow
        What it was taken from.
    kernel : SampledKernel
        The kernel.
    shown : Shown
        What its colours mean.
    parameters : KernelParameters
        What the flow was run with.
    facts, columns : dict
        What is known of its place, and of each sample's.
    unit : str
        The unit of length, if it is not what the parameters say.

    Returns
    -------
    KernelStudy
    """
    return KernelStudy(
        {**facts, **describe(kernel, shown, parameters, flow.beta, unit)},
        {**columns, **table(kernel, shown)},
        parameters.radius,
        _view(flow, kernel, shown, parameters.window),
    )


def find_cell(atlas: Atlas, index: int, column: int, row: int, width: int, name: str) -> int:
    """Find the cell of a texel.

    Parameters
    ----------
    atlas : Atlas
        The canvas.
    index : int
        The texture that the texel is in.
    column, row : int
        Of the texel.
    width : int
        Of the texture, in texels.
    name : str
        What the texel is called in messages.

    Returns
    -------
    int
        Flat index on the canvas.

    Raises
    ------
    UsageError
        If it has none: it is not on the surface, a hole, or invisible. Tells the nearest texel that has one.
    """
    first, last = atlas.texture_offsets[index : index + 2]
    mine = np.flatnonzero((atlas.owned_texels >= first) & (atlas.owned_texels < last))
    if not len(mine):
        raise UsageError(f"{name} does not take part, and nor does any other")
    y, x = np.divmod(atlas.owned_texels[mine] - first, width)
    squared = (x - column) ** 2 + (y - row) ** 2
    nearest = int(squared.argmin())
    if squared[nearest]:
        raise UsageError(
            f"{name} does not take part: it is no place of the surface, or cannot be seen; the nearest that does is "
            f"--at {x[nearest]}px,{y[nearest]}px"
        )
    return int(atlas.owned_cells[mine[nearest]])


def _view(flow: BeltramiFlow[GridManifold], kernel: SampledKernel, shown: Shown, window: int) -> WindowView:
    """Cut out what lies around a kernel."""
    reach = window // 2
    around = reach + max(reach, _LEAST_SURROUNDINGS)
    columns = flow.manifold.atlas.kind.shape[1]
    row, column = divmod(int(kernel.samples[0]), columns)
    filled = _patch(flow.manifold.atlas.kind, row, column, around) != EMPTY
    planes = _patch(flow.manifold.colours, row, column, around)
    distances = np.full(filled.shape, np.nan, np.float32)
    weights = np.zeros(filled.shape, np.float32)
    y, x = np.divmod(kernel.samples, columns)
    at = (y - row + around, x - column + around)
    distances[at], weights[at] = kernel.distances, kernel.weights
    shades = shown.shades(planes.reshape(len(planes), -1).T).reshape(*filled.shape, 3)
    return WindowView(shades, filled, distances, weights, (around, around))


def _patch(plane: NDArray[Any], row: int, column: int, around: int) -> NDArray[Any]:
    """Cut a square out of the last two axes, with zeros beyond the borders."""
    first = (max(0, row - around), max(0, column - around))
    part = plane[..., first[0] : row + around + 1, first[1] : column + around + 1]
    before = (first[0] - row + around, first[1] - column + around)
    missing = [(b, 2 * around + 1 - b - size) for b, size in zip(before, part.shape[-2:], strict=True)]
    return np.pad(part, [(0, 0)] * (plane.ndim - 2) + missing)
