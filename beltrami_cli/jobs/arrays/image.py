"""Smooth an image: arrays in, arrays out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.jobs.arrays.arguments import (
    colour_table,
    image_array,
    in_type_of,
    numbers_of,
    require_choice,
    settings_for,
)
from beltrami_cli.jobs.progress import PhaseProgress
from beltrami_cli.jobs.smoothing import smooth_layer
from beltrami_cli.layers.grid_layer import GridLayer
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.reports import VertexReport
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.surface.records import ColouredVertices, Encoding


@dataclass(frozen=True)
class ImageResult:
    """A smoothed image, with the parameters used and statistics.

    Attributes
    ----------
    colours : ndarray, shape (H, W, C)
        In the type and encoding of the input, as of `SmoothResult`. Pixels that did not change, and holes, are
        bit-identical to the input.
    beta : float
        As used, in units of length per unit of colour.
    spacing : float
        Mean distance of neighbouring pixels, in the unit of the positions; 0 if there are no pixels.
    noise : ndarray of float64, shape (C,)
        Estimated standard deviation of the noise of each channel, in the working space.
    samples : int
        Number of pixels that are not holes.
    samples_per_kernel : float
        Mean number of pixels in a kernel.
    choice : Choice or None
        Parameters that were chosen from the data, and their estimated error, if any were.
    patches : float or None
        The share of the result that was taken from patches; None if only the kernel was run.
    wrong_samples : dict
        As of `SmoothResult`.
    """

    colours: Array
    beta: float
    spacing: float
    noise: NDArray[np.float64]
    samples: int
    samples_per_kernel: float
    choice: Choice | None = None
    patches: float | None = None
    wrong_samples: dict[str, Any] = field(default_factory=dict)


def smooth_image(
    colours: ArrayLike,
    settings: SmoothSettings = DEFAULTS,
    *,
    surface: ImageSurface | None = None,
    encoding: Encoding = "srgb",
    guide: ArrayLike | None = None,
    progress: PhaseProgress | None = None,
    **overrides: Any,
) -> ImageResult:
    """Smooth an image on its plane, or on a surface, with the short-time Beltrami kernel.

    Parameters
    ----------
    colours : array_like, shape (H, W) or (H, W, C)
        Any number of channels. Types as for `smooth`; pixels with a number that is not finite are holes.
    settings : SmoothSettings
        As for `smooth`.
    surface : ImageSurface, optional
        Positions of the pixels, and holes; by default the plane without holes.
    encoding : {"srgb", "linear"}
        Encoding of the numbers in `colours`.
    guide : array_like, shape (H, W) or (H, W, G), optional
        Channels that enter the metric and are not smoothed, finite.
    progress : callable, optional
        Called with the work done so far and the total work; may raise to stop.
    **overrides
        As for `smooth`; an array of `noise` is of shape (H, W) or (H, W, C).

    Returns
    -------
    ImageResult
        With ``colours`` of shape (H, W, C), of the type of the input.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, or the shape or type of an array is wrong.

    Notes
    -----
    The image is the surface (X, beta I) with the metric g_ij = X_i . X_j + beta^2 I_i . I_j, eq. (1) of [1]_, sampled
    on a regular grid. Each iteration averages with the kernel exp(-d^2 / (4 t)), eqs. (8, 9), of its geodesic distances
    d, from fast marching on parametric manifolds [2]_.

    References
    ----------
    .. [1] A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images and manifolds",
       IEEE Trans. Image Processing 16(6), 2007, doi:10.1109/TIP.2007.894253
    .. [2] A. Spira, R. Kimmel, "An efficient solution to the eikonal equation on parametric manifolds", Interfaces and
       Free Boundaries 6, 2004, doi:10.4171/IFB/102
    """
    given = image_array(colours, "colours")
    table, shape = _pixel_colours(given)
    channels = tuple(map(str, range(table.shape[1])))
    settings, guides, noise = settings_for(settings, guide, channels, shape, overrides)
    require_choice("encoding", encoding)
    place = _checked_surface(surface, table, shape)
    assert place.valid is not None
    valid = place.valid.reshape(-1)
    grid = np.full(shape, -1, np.int32)
    grid[place.valid] = np.arange(np.count_nonzero(valid))
    layer = GridLayer(
        vertices=ColouredVertices(
            positions=np.empty((np.count_nonzero(valid), 0)),  # which `surface` has
            faces=np.empty((0, 3), np.int32),
            colours=table if valid.all() else table[valid],
            channels=channels,
            encoding=encoding,
            stored=str(given.dtype),
        ),
        grid=grid,
        surface=place,
        settings=settings,
        guides=[replace(guide, values=guide.values[valid]) for guide in guides],
        noise=None if noise is None else noise[valid],
    )
    done = smooth_layer(layer, progress)
    report, smoothed = done.report, table.copy()
    assert isinstance(report, VertexReport)
    smoothed[valid] = done.stored.colours
    return ImageResult(
        colours=in_type_of(given, table, smoothed).reshape(*shape, -1), beta=report.beta, spacing=report.spacing,
        noise=np.array(list(report.noise.values())), samples=int(report.counts["samples"]),
        samples_per_kernel=done.samples_per_kernel, choice=done.choice, patches=report.patches,
        wrong_samples=report.wrong_samples,
    )  # fmt: skip


def _checked_surface(surface: ImageSurface | None, table: Float32s, shape: tuple[int, int]) -> ImageSurface:
    """Check where pixels lie; where a colour, height or position is not finite is a hole, too."""
    valid = np.asarray(np.isfinite(table.reshape(*shape, -1)).all(axis=2))
    if surface is None:
        return ImageSurface(valid=valid)
    if surface.positions is not None and surface.heights is not None:
        raise UsageError("positions and heights are two surfaces for one image; give one of them")
    positions, heights = surface.positions, surface.heights
    if positions is not None:
        positions = numbers_of(positions, "positions", (*shape, "M")).astype(np.float64)
        valid &= np.isfinite(positions).all(axis=2)
    if heights is not None:
        heights = numbers_of(heights, "heights", shape).astype(np.float64)
        valid &= np.isfinite(heights)
    if surface.valid is not None:
        valid &= numbers_of(surface.valid, "valid", shape, "bui").astype(bool)
    return ImageSurface(heights, positions, valid)


def _pixel_colours(image: Array) -> tuple[Float32s, tuple[int, int]]:
    """Return the colours of all pixels, shape (H * W, C), and the shape (H, W)."""
    if image.ndim not in (2, 3) or image.size == 0:
        raise UsageError(f"colours must be of shape (H, W) or (H, W, C), not {image.shape}")
    rows, columns = image.shape[:2]
    return colour_table(image.reshape(rows * columns, -1)), (rows, columns)
