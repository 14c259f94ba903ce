"""Painted vertices as samples of a manifold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.colour_space import to_space
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.flow.geometry import GeometryParameters
from beltrami_cli.flow.mesh_manifold import MeshManifold
from beltrami_cli.samples.vertices.channels import ChosenChannels, choose_channels
from beltrami_cli.surface.vertex_sampling import VertexSampling, sample_vertices

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices, SampledSurface


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

    def flow(self, settings: SmoothSettings) -> BeltramiFlow[MeshManifold]:
        """Make the flow on these samples."""
        geometry = None
        if settings.embedding.smooth_geometry:
            geometry = GeometryParameters(self.sampling.place_of, settings.embedding.normal_beta)
        manifold = MeshManifold(
            self.surface,
            settings.kernel,
            guides=self.guides,
            metric_channels=self.channels.metric,
            geometry=geometry,
        )
        return BeltramiFlow(manifold, settings.kernel)


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
