"""The kernel of a vertex of a range image, on the grid that it was measured on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.jobs.kernel.cells import study_cell
from beltrami_cli.jobs.kernel.study import KernelStudy, Shown
from beltrami_cli.samples.images.range_image import prepare_range

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.jobs.kernel.place import Place
    from beltrami_cli.samples.settings.smooth import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices


def study_range(
    painted: PaintedVertices,
    grid: NDArray[np.int64],
    name: str,
    place: Place,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
    guides: Sequence[Guide] = (),
) -> KernelStudy:
    """Study the kernel of a vertex after the iterations that the settings ask for.

    Parameters
    ----------
    painted : PaintedVertices
        The vertices.
    grid : ndarray of int64, shape (H, W)
        Which vertex stands at each place, -1 for none.
    name : str
        The file's name for messages.
    place : Place
        A vertex by its index or a position, or column and row on the grid.
    settings : SmoothSettings
        As for smoothing.
    progress : callable, optional
        Of the iterations before.
    guides : sequence of Guide
        With a row for each vertex.

    Returns
    -------
    KernelStudy

    Raises
    ------
    UsageError
        If the place names no vertex on the grid, or as `prepare_range`.
    """
    prepared = prepare_range(painted, grid, settings, guides)
    flow = prepared.flow(settings)
    vertex = _vertex_at(painted, grid, name, place)
    vertices = grid.reshape(-1)[flow.manifold.atlas.owned_texels]
    (found,) = np.nonzero(vertices == vertex)
    if not len(found):
        raise UsageError(f"--at {place.text}: {name} has no measured vertex on its grid there")
    flow.run(progress)
    kernel = flow.kernel_at(int(flow.manifold.atlas.owned_cells[found[0]]))
    held = vertices[np.searchsorted(flow.manifold.atlas.owned_cells, kernel.samples)]
    shown = Shown(
        tuple(painted.channels[channel] for channel in prepared.channels.taking_part), settings.space
    )
    facts: dict[str, object] = {"at": f"vertex {vertex}", "position": painted.positions[vertex].tolist()}
    columns = {"vertex": held, **dict(zip("xyz", painted.positions[held].T, strict=True))}
    return study_cell(flow, kernel, shown, settings.kernel, facts, columns)


def _vertex_at(painted: PaintedVertices, grid: NDArray[np.int64], name: str, place: Place) -> int:
    if len(place.numbers) != 2:
        return place.vertex_among(painted.positions, name)
    column, row = place.pixel_of(grid.shape[1], grid.shape[0], name)
    return int(grid[row, column])
