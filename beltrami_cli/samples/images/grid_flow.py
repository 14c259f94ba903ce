"""The flow on a regular grid of samples: the plane of an image, the surface over it, or a map of positions."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Protocol

import numpy as np

from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.canvas import painted
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.surface.atlas import grid_atlas

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.flow.parameters import KernelParameters


class GuidePixels(Protocol):
    """A guide that is known at every pixel."""

    def at(self, pixels: NDArray[np.int64]) -> Guide:
        """Return the guide at some pixels (row * width + column)."""


def grid_flow(
    valid: NDArray[np.bool_],
    colours_of: Callable[[NDArray[np.int64]], NDArray[np.float32]],
    kernel: KernelParameters,
    *,
    positions: NDArray[np.float64] | None = None,
    heights: NDArray[np.float64] | None = None,
    guides: Sequence[GuidePixels] = (),
    metric_channels: Sequence[int] | None = None,
) -> BeltramiFlow[GridManifold]:
    """Make the flow on an image.

    Parameters
    ----------
    valid : ndarray of bool, shape (H, W)
        False at holes, which nothing crosses.
    colours_of : callable
        Gives the colours, shape (T, N), of T pixels (row * W + column), which are valid.
    kernel : KernelParameters
        What to run with.
    positions : ndarray of float64, shape (H, W, M), optional
        Where the pixels lie. The unit of length is what `kernel` says.
    heights : ndarray of float64, shape (H, W), optional
        The surface (x, y, height) over the plane of the image. Here, as on the plane, the unit of length is the pixel,
        and not the spacing along the surface: on slopes samples lie further apart, so they are smoothed less.
    guides : sequence of GuidePixels
        What enters the metric besides the colours.
    metric_channels : sequence of int, optional
        Which of the N colour channels enter the metric; without it all.

    Returns
    -------
    BeltramiFlow
        Its owned texels are the pixels that are no holes, row by row.
    """
    if heights is not None:
        valid = valid & np.isfinite(heights)
        positions = _over_the_plane(heights)
        kernel = dataclasses.replace(kernel, units="world")
    margin = kernel.window // 2 + (guide_radius(kernel.metric_scale) if kernel.metric_steps else 0)
    atlas = grid_atlas(valid.shape, margin, positions, valid)
    del positions  # as large as all that follows
    manifold = GridManifold(
        atlas,
        painted(atlas, colours_of(atlas.owned_texels), kernel.thread_count),
        kernel,
        walls=atlas.covered < valid.size,
        guides=[guide.at(atlas.owned_texels) for guide in guides],
        metric_channels=metric_channels,
        unit=None if heights is None else 1.0,
    )
    return BeltramiFlow(manifold, kernel)


def _over_the_plane(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the places (x, y, height) of pixels, shape (H, W, 3)."""
    rows, columns = heights.shape
    positions = np.empty((rows, columns, 3))
    positions[..., 0], positions[..., 1] = np.arange(columns), np.arange(rows)[:, None]
    positions[..., 2] = heights
    return positions
