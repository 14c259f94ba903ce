"""Smooth an image on the plane or on a surface: arrays in, arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.flow.parameters import Clipping, KernelParameters, Space
from beltrami_cli.mesh.painted import Encoding
from beltrami_cli.mesh.validation import array_of, check_numbers, colour_table
from beltrami_cli.pipeline.grid_flow import grid_flow
from beltrami_cli.pipeline.settings import DEFAULTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from beltrami_cli.flow.parameters import Scheme, Units


@dataclass(frozen=True)
class ImageResult:
    """A smoothed image, and how it came about.

    Attributes
    ----------
    colours : ndarray of float32, shape (H, W, C)
        In the same encoding as the input's. Pixels that did not change, and holes, have the input's bits.
    beta : float
        As used, in units of length per unit of colour.
    spacing : float
        Mean distance of neighbouring pixels, in the unit of the positions; 0 if there are no pixels.
    noise : ndarray of float64, shape (C,)
        Estimated standard deviation of the noise of each channel, in the working space.
    samples : int
        Pixels that are no holes.
    samples_per_kernel : float
        Mean number of pixels that a kernel held.
    """

    colours: NDArray[np.float32]
    beta: float
    spacing: float
    noise: NDArray[np.float64]
    samples: int
    samples_per_kernel: float


def smooth_image(
    colours: ArrayLike,
    *,
    positions: ArrayLike | None = None,
    height: ArrayLike | None = None,
    height_scale: float = 1.0,
    valid: ArrayLike | None = None,
    iterations: int = DEFAULTS.kernel.iterations,
    t: float = DEFAULTS.kernel.t,
    beta: float | None = DEFAULTS.kernel.beta,
    beta_growth: float = DEFAULTS.kernel.beta_growth,
    threshold: float = DEFAULTS.kernel.threshold,
    units: Units = DEFAULTS.kernel.units,
    threads: int | None = DEFAULTS.kernel.threads,
    window: int = DEFAULTS.kernel.window,
    metric_scale: float = DEFAULTS.kernel.metric_scale,
    metric_steps: int = DEFAULTS.kernel.metric_steps,
    scheme: Scheme = DEFAULTS.kernel.scheme,
    clipping: Clipping = DEFAULTS.kernel.clipping,
    space: Space = DEFAULTS.space,
    encoding: Encoding = "srgb",
    progress: Callable[[int, int], None] | None = None,
) -> ImageResult:
    """Smooth an image on its plane, or on a surface, with the short-time Beltrami kernel.

    Parameters
    ----------
    colours : array_like, shape (H, W) or (H, W, C)
        Any number of channels. uint8, uint16 and uint32 are taken by their full scale, floats as they are (full
        scale 1). Pixels with a channel that is not finite are holes.
    positions : array_like, shape (H, W, M), optional
        Where the pixels lie, in a space of any dimension M. Pixels with a coordinate that is not finite are holes.
    height : array_like, shape (H, W), optional
        Instead of positions: the surface (x, y, `height_scale` * height) over the plane of the image, in pixels.
        Pixels with a height that is not finite are holes.
    height_scale : float
        Pixels per unit of height.
    valid : array_like of bool, shape (H, W), optional
        False at holes. They keep their colours, lend none, and nothing crosses them.
    iterations : int
        Number N of kernel iterations.
    t : float
        Time step, in squared units of length.
    beta : float or None
        Units of length per unit of colour; None: from the estimated noise. 0: a Gaussian.
    beta_growth : float
        Factor, 1 or more, by which beta grows from one iteration to the next.
    threshold : float
        Pixels with a kernel value below it are left out.
    units : {"spacing", "world"}
        Unit of length on positions: the mean distance of neighbours around, or the positions' own. On the plane and
        over heights the unit is the pixel.
    threads : int or None
        None: all that the process may use. The result does not depend on it.
    window : int
        Pixels a side of the square in which a kernel is looked for, odd.
    metric_scale : float
        Take distances from colours smoothed by a Gaussian of this standard deviation, in pixels ...
    metric_steps : int
        ... in so many of the first iterations; the colours themselves are averaged.
    scheme : {"triangles", "metric"}
        Distances through the triangles of neighbouring pixels, or the paper's parametric fast marching.
    clipping : {"restore", "keep"}
        Whether averages are corrected where noise was cut off at 0 or full scale.
    space : {"srgb", "linear", "oklab", "data"}
        What distances and averages of colours are taken in; "data": the numbers as they are.
    encoding : {"srgb", "linear"}
        What the numbers in `colours` mean.
    progress : callable, optional
        Called with the work done so far and the work to do; may raise to stop.

    Returns
    -------
    ImageResult

    Raises
    ------
    UsageError
        If a parameter is out of its range, or an array's shape or type does not fit.

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
    check_numbers(
        {
            "iterations": iterations,
            "metric_steps": metric_steps,
            "window": window,
            "threads": 1 if threads is None else threads,
        },
        {
            "t": t,
            "beta": 0 if beta is None else beta,
            "threshold": threshold,
            "metric_scale": metric_scale,
            "beta_growth": beta_growth,
            "height_scale": height_scale,
        },
    )
    kernel = KernelParameters(
        iterations=iterations,
        t=t,
        beta=beta,
        beta_growth=beta_growth,
        threshold=threshold,
        units=units,
        threads=threads,
        window=window,
        metric_scale=metric_scale,
        metric_steps=metric_steps,
        scheme=scheme,
        clipping=clipping,
    )
    if space not in get_args(Space):
        raise UsageError(f"space is {space}, but must be {', '.join(get_args(Space))}")
    if encoding not in get_args(Encoding):
        raise UsageError(f"encoding is {encoding}, but must be {' or '.join(get_args(Encoding))}")
    if positions is not None and height is not None:
        raise UsageError("positions and height are two surfaces for one image; give one of them")
    image = _Image(*_colours(colours), encoding, space)
    return image.smooth(
        None if valid is None else _array(valid, "valid", image.shape, "bui").astype(bool),
        None if positions is None else _array(positions, "positions", (*image.shape, None), "uif"),
        None if height is None else height_scale * _array(height, "height", image.shape, "uif"),
        kernel,
        progress,
    )


@dataclass(frozen=True)
class _Image:
    """Colours of all pixels, shape (H * W, C), the shape (H, W), and what the numbers mean."""

    table: NDArray[np.float32]
    shape: tuple[int, int]
    encoding: Encoding
    space: Space

    def __post_init__(self) -> None:
        if self.space == "oklab" and self.table.shape[1] != 3:
            raise UsageError("the space oklab needs three channels")

    def smooth(
        self,
        valid: NDArray[np.bool_] | None,
        positions: NDArray[Any] | None,
        heights: NDArray[Any] | None,
        kernel: KernelParameters,
        progress: Callable[[int, int], None] | None,
    ) -> ImageResult:
        whole = np.asarray(np.isfinite(self.table.reshape(*self.shape, -1)).all(axis=2))
        if valid is not None:
            whole = whole & valid
        flow = grid_flow(
            whole,
            self._working,
            kernel,
            positions=None if positions is None else positions.astype(np.float64),
            heights=None if heights is None else heights.astype(np.float64),
        )
        result = flow.run(progress)
        pixels = flow.atlas.owned_texels
        return ImageResult(
            self._with(pixels, result.colours).reshape(*self.shape, -1),
            result.beta,
            result.spacing,
            result.sigma,
            len(pixels),
            result.samples_per_kernel,
        )

    def _working(self, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        return to_space(self.table[pixels], self.encoding, self.space)

    def _with(self, pixels: NDArray[np.int64], after: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of all pixels with the new ones of some."""
        smoothed = self.table.copy()
        moved = np.any(self._working(pixels) != after, axis=1)
        if moved.any():
            back = from_space(after[moved], self.encoding, self.space)
            # The way there and back is not exact; what comes of it stays in the range of the colours.
            old = self.table[pixels]
            smoothed[pixels[moved]] = np.clip(back, old.min(axis=0), old.max(axis=0))
        return smoothed


def _colours(colours: ArrayLike) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Return the colours of all pixels, shape (H * W, C), and the shape (H, W)."""
    image = array_of(colours, "colours")
    if image.ndim not in (2, 3) or image.size == 0:
        raise UsageError(f"colours must be of shape (H, W) or (H, W, C), not {image.shape}")
    rows, columns = image.shape[:2]
    return colour_table(image.reshape(rows * columns, -1)), (rows, columns)


def _array(values: ArrayLike, name: str, shape: tuple[int | None, ...], kinds: str) -> NDArray[Any]:
    """Take an array with a number for each pixel, or M numbers where the last of the shape is None."""
    array = array_of(values, name)
    fits = array.ndim == len(shape) and all(
        b is None or a == b for a, b in zip(array.shape, shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds or 0 in array.shape:
        wanted = ", ".join("M" if size is None else str(size) for size in shape)
        raise UsageError(
            f"{name} must be numbers of shape ({wanted}), not {array.dtype} of shape {array.shape}"
        )
    return array
