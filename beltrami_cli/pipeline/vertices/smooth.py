"""Smooth vertex colours: painted vertices in, new colours out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.flow.geometry import GeometryParameters
from beltrami_cli.flow.guidance import Guide
from beltrami_cli.flow.iteration import BeltramiFlow
from beltrami_cli.sampling.vertices import VertexSampling, sample_vertices

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.choice import Choice
    from beltrami_cli.flow.result import VertexFlowResult
    from beltrami_cli.mesh.painted import PaintedVertices
    from beltrami_cli.mesh.surface import SampledSurface
    from beltrami_cli.pipeline.settings.smooth import SmoothSettings


@dataclass(frozen=True)
class CloudCounts:
    """What was found between points without faces.

    Attributes
    ----------
    triangles : int
        Triangles around the points, each in the tangent plane.
    outliers : int
        Points in none of them, which keep their colours.
    """

    triangles: int
    outliers: int


@dataclass(frozen=True)
class SmoothResult:
    """Smoothed vertex colours, and how they came about.

    Attributes
    ----------
    colours : ndarray of float32, shape (V, C)
        In the same encoding and order as the input's. Vertices that did not change have the input's bits.
    beta : float
        As used, in units of length per unit of colour; 0 if no colour enters the metric.
    spacing : float
        Mean edge length, in the unit of the positions; 0 without edges.
    noise : dict of str to float
        Estimated standard deviation of the noise for each channel that takes part, in the working space.
    samples : int
        Distinct samples: coincident vertices of one colour are one.
    hard_edge_samples : int
        Samples more than there are places: coincident vertices that differ in colour.
    samples_per_kernel : float
        Mean number of samples that a kernel held.
    truncated : int
        Kernels that `max_samples` cut short, over all iterations.
    iterations : int
        How many were run.
    guide_betas : dict of str to float
        As used for each guide, in units of length per unit of the guide.
    positions : ndarray of float64, shape (V, 3), or None
        New positions, if they were smoothed. Vertices that did not move have the input's bits.
    normal_noise, normal_beta : float or None
        If positions were smoothed: the estimated noise of the normals in radians, and the beta used for them, in units
        of length per radian.
    cloud : CloudCounts or None
        For points without faces.
    choice : Choice or None
        Parameters that were chosen from the data, and their estimated error, if any were.
    """

    colours: NDArray[np.float32]
    beta: float
    spacing: float
    noise: dict[str, float]
    samples: int
    hard_edge_samples: int
    samples_per_kernel: float
    truncated: int
    iterations: int
    guide_betas: dict[str, float] = field(default_factory=dict)
    positions: NDArray[np.float64] | None = None
    normal_noise: float | None = None
    normal_beta: float | None = None
    cloud: CloudCounts | None = None
    choice: Choice | None = None


@dataclass(frozen=True)
class ChosenChannels:
    """Which columns of vertices' colours do what.

    Attributes
    ----------
    taking_part : list of int
        Those that the samples have: those that change, and those that enter the metric.
    changing : list of int
        Those that change.
    metric : list of int or None
        Which of those that take part enter the metric, counted among these; None: all.
    """

    taking_part: list[int]
    changing: list[int]
    metric: list[int] | None

    @property
    def written(self) -> list[int]:
        """Those that change, counted among those that take part."""
        return [self.taking_part.index(channel) for channel in self.changing]


@dataclass(frozen=True)
class PreparedVertices:
    """Painted vertices as samples of a manifold.

    Attributes
    ----------
    channels : ChosenChannels
        What the samples have of the vertices' colours.
    surface : SampledSurface
        With these channels in the working space.
    sampling : VertexSampling
        The way back to vertices.
    guides : tuple of Guide
        With one row a sample.
    """

    channels: ChosenChannels
    surface: SampledSurface
    sampling: VertexSampling
    guides: tuple[Guide, ...]

    def flow(self, settings: SmoothSettings) -> BeltramiFlow:
        """Make the flow on these samples."""
        geometry = None
        if settings.embedding.smooth_geometry:
            geometry = GeometryParameters(self.sampling.place_of, settings.embedding.normal_beta)
        return BeltramiFlow(
            self.surface,
            settings.kernel,
            guides=self.guides,
            metric_channels=self.channels.metric,
            geometry=geometry,
        )


def prepare(
    painted: PaintedVertices, settings: SmoothSettings, guides: Sequence[Guide] = ()
) -> PreparedVertices:
    """Make the samples that the settings ask for.

    Parameters
    ----------
    painted : PaintedVertices
        As a document gives it.
    settings : SmoothSettings
        The working space and the channels.
    guides : sequence of Guide
        With one row a vertex. A sample has the mean of its vertices.

    Raises
    ------
    UsageError
        If the settings name channels that are not there.
    """
    channels = choose_channels(painted, settings)
    working = to_space(painted.colours[:, channels.taking_part], painted.encoding, settings.space)
    surface, sampling = sample_vertices(painted, working)
    sampled = tuple(Guide(guide.name, sampling.means(guide.values), guide.beta) for guide in guides)
    return PreparedVertices(channels, surface, sampling, sampled)


def smooth_painted(
    painted: PaintedVertices,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
    guides: Sequence[Guide] = (),
) -> SmoothResult:
    """Smooth painted vertices, as `smooth` does with arrays.

    Parameters
    ----------
    painted : PaintedVertices
        As a document gives it.
    settings : SmoothSettings
        The kernel's parameters, the working space, the channels and the embedding; guides are taken from `guides`.
    progress : callable, optional
        As in `smooth`.
    guides : sequence of Guide
        With one row a vertex.

    Returns
    -------
    SmoothResult

    Raises
    ------
    UsageError
        If the settings name channels that are not there.
    """
    prepared = prepare(painted, settings, guides)
    flow, sampling = prepared.flow(settings), prepared.sampling
    channels, before = prepared.channels, prepared.surface.colours
    del prepared  # the flow has its own order of everything, and a large mesh is not held twice
    result = flow.run(progress)
    colours = painted.colours.copy()
    colours[:, channels.changing] = _to_vertices(painted, settings, channels, before, sampling, result)
    moving = flow.moving
    return SmoothResult(
        colours,
        result.beta,
        result.spacing,
        {painted.channels[i]: float(s) for i, s in zip(channels.taking_part, result.sigma, strict=True)},
        len(before),
        len(before) - sampling.places,
        result.samples_per_kernel,
        result.truncated,
        flow.parameters.iterations,
        flow.guide_betas,
        None if result.positions is None else result.positions[sampling.sample_of],
        None if moving is None else moving.sigma,
        None if moving is None else moving.beta,
        choice=result.choice,
    )


def require_surface(painted: PaintedVertices, name: str) -> None:
    """Refuse a file whose vertices nothing joins.

    Raises
    ------
    InputError
        If there are no triangles.
    """
    if not len(painted.faces):
        raise InputError(
            name,
            f"its {len(painted.positions)} coloured vertices have no faces, so there is no surface to smooth on",
            "triangulate the points first",
        )


def _to_vertices(
    painted: PaintedVertices,
    settings: SmoothSettings,
    channels: ChosenChannels,
    samples: NDArray[np.float32],
    sampling: VertexSampling,
    flow: VertexFlowResult,
) -> NDArray[np.float32]:
    before, written = painted.colours[:, channels.changing], channels.written
    back = from_space(flow.colours[:, written], painted.encoding, settings.space)
    # The way there and back is not exact: what did not change keeps its bits, and what did stays in range.
    if len(before):
        back = np.clip(back, before.min(axis=0), before.max(axis=0))
    changed = np.any(flow.colours[:, written] != samples[:, written], axis=1)[sampling.sample_of]
    return np.where(changed[:, None], back[sampling.sample_of], before)


def choose_channels(painted: PaintedVertices, settings: SmoothSettings) -> ChosenChannels:
    """Choose the columns of vertices' colours by the settings.

    Raises
    ------
    UsageError
        If the settings name channels that are not there.
    """
    changing = _columns(painted, settings.channels)
    wanted = settings.embedding.metric_channels
    counting = changing if wanted is None else _columns(painted, wanted)
    channels = sorted({*changing, *counting})
    metric = None if counting == channels else [channels.index(channel) for channel in counting]
    return ChosenChannels(channels, changing, metric)


def _columns(painted: PaintedVertices, names: tuple[str, ...] | None) -> list[int]:
    """Find the columns of channels by their names or first letters; None: all."""
    if names is None:
        return list(range(len(painted.channels)))
    columns = []
    for name in names:
        fits = [i for i, channel in enumerate(painted.channels) if name.lower() in (channel, channel[0])]
        if not fits:
            raise UsageError(f"there is no channel {name}; the colours have {', '.join(painted.channels)}")
        columns.append(fits[0])
    return sorted(set(columns))
