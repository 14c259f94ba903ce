"""The flow on a regular grid of samples: the plane of an image, the surface over it, or a map of positions."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.guide import guide_radius
from beltrami_cli.flow.noise import choose_beta, estimate_sigma_on_grid
from beltrami_cli.flow.texels import TexelFlow
from beltrami_cli.sampling.grid import grid_atlas

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import KernelParameters


def grid_flow(
    valid: NDArray[np.bool_],
    colours_of: Callable[[NDArray[np.int64]], NDArray[np.float32]],
    kernel: KernelParameters,
    *,
    positions: NDArray[np.float64] | None = None,
    heights: NDArray[np.float64] | None = None,
) -> TexelFlow:
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

    Returns
    -------
    TexelFlow
        Its owned texels are the pixels that are no holes, row by row.
    """
    if heights is not None:
        valid = valid & np.isfinite(heights)
        positions = _over_the_plane(heights)
        kernel = dataclasses.replace(kernel, units="world")
    margin = kernel.window // 2 + (guide_radius(kernel.metric_scale) if kernel.metric_steps else 0)
    atlas = grid_atlas(valid.shape, margin, positions, valid)
    del positions  # as large as all that follows
    colours = colours_of(atlas.owned_texels)
    if heights is not None and kernel.beta is None:
        kernel = dataclasses.replace(
            kernel, beta=choose_beta(_noise(colours, atlas.owned_texels, valid.shape))
        )
    return TexelFlow(atlas, colours, kernel, walls=atlas.covered < valid.size)


def _over_the_plane(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the places (x, y, height) of pixels, shape (H, W, 3)."""
    rows, columns = heights.shape
    positions = np.empty((rows, columns, 3))
    positions[..., 0], positions[..., 1] = np.arange(columns), np.arange(rows)[:, None]
    positions[..., 2] = heights
    return positions


def _noise(
    colours: NDArray[np.float32], pixels: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Estimate the noise of colours of some pixels of an image."""
    planes = np.zeros((colours.shape[1], *shape), np.float32)
    planes.reshape(len(planes), -1)[:, pixels] = colours.T
    filled = np.zeros(shape, bool)
    filled.reshape(-1)[pixels] = True
    return estimate_sigma_on_grid(planes, filled)
