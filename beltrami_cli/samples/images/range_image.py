"""Smooth the colours of a range image: vertices on the grid that they were measured on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.samples.images.grid_flow import grid_flow
from beltrami_cli.samples.settings import DEFAULTS
from beltrami_cli.samples.vertices.channels import ChosenChannels, choose_channels
from beltrami_cli.samples.vertices.result import SmoothResult

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.grid_manifold import GridManifold
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices


@dataclass(frozen=True)
class PreparedRange:
    """A range image as samples of a manifold.

    Attributes
    ----------
    painted : PaintedVertices
        The vertices; faces do not count.
    grid : ndarray of int64, shape (H, W)
        Which vertex stands at each place, -1 for none.
    channels : ChosenChannels
        Which columns of the vertices' colours take part.
    guides : tuple of Guide
        With a row for each vertex.
    """

    painted: PaintedVertices
    grid: NDArray[np.int64]
    channels: ChosenChannels
    guides: tuple[Guide, ...]

    def flow(self, settings: SmoothSettings) -> BeltramiFlow[GridManifold]:
        """Make the flow on these samples."""
        measured = self.grid >= 0
        positions = np.full((*self.grid.shape, 3), np.nan)
        positions[measured] = self.painted.positions[self.grid[measured]]
        return grid_flow(
            measured,
            lambda places: self.working(places, settings),
            settings.kernel,
            positions=positions,
            guides=[_GuideOnGrid(guide, self.grid) for guide in self.guides],
            metric_channels=self.channels.metric,
        )

    def working(self, places: NDArray[np.int64], settings: SmoothSettings) -> NDArray[np.float32]:
        """Return the colours at some places of the grid in the working space, shape (T, N)."""
        colours = self.painted.colours[self.grid.reshape(-1)[places]][:, self.channels.taking_part]
        return to_space(colours, self.painted.encoding, settings.space)

    def named(self, values: NDArray[np.float64]) -> dict[str, float]:
        """Pair a value per channel with the channels' names."""
        names = [self.painted.channels[channel] for channel in self.channels.taking_part]
        return {name: float(value) for name, value in zip(names, values, strict=True)}


@dataclass(frozen=True)
class _GuideOnGrid:
    guide: Guide
    grid: NDArray[np.int64]

    def at(self, pixels: NDArray[np.int64]) -> Guide:
        values = self.guide.values[self.grid.reshape(-1)[pixels]]
        return Guide(self.guide.name, values, self.guide.beta)


def prepare_range(
    painted: PaintedVertices,
    grid: NDArray[np.int64],
    settings: SmoothSettings,
    guides: Sequence[Guide] = (),
) -> PreparedRange:
    """Make the samples that the settings ask for.

    Parameters
    ----------
    painted, grid, settings, guides
        As for `smooth_range`.

    Raises
    ------
    UsageError
        If the settings name channels that are not there, or what is not done on grids.
    """
    given = {
        "--weights": settings.kernel.weights != DEFAULTS.kernel.weights,
        "--max-samples": settings.kernel.max_samples != DEFAULTS.kernel.max_samples,
        "--smooth-geometry": settings.embedding.smooth_geometry,
    }
    wrong = [option for option, is_given in given.items() if is_given]
    if wrong:
        raise UsageError(
            f"{', '.join(wrong)}: not on range images, whose vertices lie on a grid; leave it out"
        )
    return PreparedRange(painted, grid, choose_channels(painted, settings), tuple(guides))


def smooth_range(
    painted: PaintedVertices,
    grid: NDArray[np.int64],
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
    guides: Sequence[Guide] = (),
) -> SmoothResult:
    """Smooth the colours of vertices that lie on a grid, as an image on the surface that was measured.

    Parameters
    ----------
    painted : PaintedVertices
        The vertices; faces do not count. Those with a position that is not finite are holes.
    grid : ndarray of int64, shape (H, W)
        Which vertex stands at each place, -1 for none; each at most once. Vertices that stand nowhere stay as they are.
    settings : SmoothSettings
        The kernel's parameters, the working space and the channels.
    progress : callable, optional
        Called with the work done so far and the work to do; may raise to stop.
    guides : sequence of Guide
        With a row for each vertex.

    Returns
    -------
    SmoothResult

    Raises
    ------
    UsageError
        As `prepare_range`.
    """
    prepared = prepare_range(painted, grid, settings, guides)
    flow = prepared.flow(settings)
    result = flow.run(progress)
    places = flow.manifold.atlas.owned_texels
    changing, written = prepared.channels.changing, prepared.channels.written
    after = flow.values()[:, written]
    moved = np.any(prepared.working(places, settings)[:, written] != after, axis=1)
    vertices = grid.reshape(-1)[places[moved]]
    colours = painted.colours.copy()
    if len(vertices):
        before = painted.colours[:, changing]
        back = from_space(after[moved], painted.encoding, settings.space)
        # The way there and back is not exact; what comes of it stays in range.
        colours[vertices[:, None], changing] = np.clip(back, before.min(axis=0), before.max(axis=0))
    return SmoothResult(
        colours,
        result.beta,
        result.spacing,
        prepared.named(result.sigma),
        len(places),
        0,
        result.samples_per_kernel,
        0,
        flow.parameters.iterations,
        flow.manifold.guide_betas,
        choice=result.choice,
    )
