"""Smooth vertex colours: painted vertices in, new colours out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.colour_space import from_space
from beltrami_cli.samples.vertices.prepare import prepare
from beltrami_cli.samples.vertices.result import SmoothResult

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.samples.vertices.channels import ChosenChannels
    from beltrami_cli.surface.records import PaintedVertices
    from beltrami_cli.surface.vertex_sampling import VertexSampling


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
    colours[:, channels.changing] = _to_vertices(painted, settings, channels, before, sampling, flow.values())
    manifold = flow.manifold
    moving = manifold.moving
    positions = None if moving is None else manifold.in_order(moving.positions)
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
        manifold.guide_betas,
        None if positions is None else positions[sampling.sample_of],
        None if moving is None else moving.sigma,
        None if moving is None else moving.beta,
        choice=result.choice,
    )


def _to_vertices(
    painted: PaintedVertices,
    settings: SmoothSettings,
    channels: ChosenChannels,
    samples: NDArray[np.float32],
    sampling: VertexSampling,
    after: NDArray[np.float32],
) -> NDArray[np.float32]:
    before, written = painted.colours[:, channels.changing], channels.written
    back = from_space(after[:, written], painted.encoding, settings.space)
    # The way there and back is not exact: what did not change keeps its bits, and what did stays in range.
    if len(before):
        back = np.clip(back, before.min(axis=0), before.max(axis=0))
    changed = np.any(after[:, written] != samples[:, written], axis=1)[sampling.sample_of]
    return np.where(changed[:, None], back[sampling.sample_of], before)
