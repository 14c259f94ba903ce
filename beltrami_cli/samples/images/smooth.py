"""Smooth an image on the plane or on a surface: arrays in, arrays out."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.embedding import centred
from beltrami_cli.flow.parameters import Space, parameters_with
from beltrami_cli.samples.images.arrays import ArrayImage, ImageResult, pixel_array, pixel_colours
from beltrami_cli.samples.images.guides import GuideImage
from beltrami_cli.samples.settings import DEFAULTS, EmbeddingSettings
from beltrami_cli.surface.records import Encoding
from beltrami_cli.surface.validation import check_numbers, guide_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    from beltrami_cli.flow.parameters import Clipping, Scheme, Strength, Units


def smooth_image(
    colours: ArrayLike,
    *,
    positions: ArrayLike | None = None,
    height: ArrayLike | None = None,
    height_scale: float = 1.0,
    valid: ArrayLike | None = None,
    iterations: int | None = None,
    t: float | None = None,
    beta: float | None = None,
    beta_growth: float | None = None,
    threshold: float = DEFAULTS.kernel.threshold,
    units: Units = DEFAULTS.kernel.units,
    threads: int | None = DEFAULTS.kernel.threads,
    window: int = DEFAULTS.kernel.window,
    metric_scale: float = DEFAULTS.kernel.metric_scale,
    metric_steps: int | None = None,
    scheme: Scheme = DEFAULTS.kernel.scheme,
    clipping: Clipping = DEFAULTS.kernel.clipping,
    strength: Strength = DEFAULTS.kernel.strength,
    fast: bool = False,
    space: Space = DEFAULTS.space,
    encoding: Encoding = "srgb",
    guide: ArrayLike | None = None,
    guide_beta: float | None = None,
    metric_channels: Sequence[int] | None = None,
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
    iterations : int, optional
        Number N of kernel iterations. It, `t`, `beta`, `beta_growth` and `metric_steps` are chosen from the data where
        they are not given, by the estimated error of the result; see `strength` and `fast`.
    t : float, optional
        Time step, in squared units of length.
    beta : float, optional
        Units of length per unit of colour. 0: a Gaussian.
    beta_growth : float, optional
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
    metric_steps : int, optional
        ... in so many of the first iterations; the colours themselves are averaged.
    scheme : {"triangles", "metric"}
        Distances through the triangles of neighbouring pixels, or the paper's parametric fast marching.
    clipping : {"restore", "keep"}
        Whether averages are corrected where noise was cut off at 0 or full scale.
    strength : {"gentle", "normal", "strong"}
        Whether what is chosen smooths less or more than what is estimated to be best.
    fast : bool
        Whether parameters that are not given follow a fixed rule instead, which takes no time.
    space : {"srgb", "linear", "oklab", "data"}
        What distances and averages of colours are taken in; "data": the numbers as they are.
    encoding : {"srgb", "linear"}
        What the numbers in `colours` mean.
    guide : array_like, shape (H, W) or (H, W, G), optional
        Channels that enter the metric and stay as they are, finite.
    guide_beta : float or None
        Pixels (or units of length) per unit of the guide; None: from the guide, see `choose_guide_beta`.
    metric_channels : sequence of int, optional
        Which colour channels enter the metric; without it all. Empty: only the surface and the guide do.
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
            "iterations": 0 if iterations is None else iterations,
            "metric_steps": 0 if metric_steps is None else metric_steps,
            "window": window,
            "threads": 1 if threads is None else threads,
        },
        {
            "t": 1 if t is None else t,
            "beta": 0 if beta is None else beta,
            "threshold": threshold,
            "metric_scale": metric_scale,
            "beta_growth": 1 if beta_growth is None else beta_growth,
            "guide_beta": 0 if guide_beta is None else guide_beta,
            "height_scale": height_scale,
        },
    )
    kernel = parameters_with(
        {
            "iterations": iterations,
            "t": t,
            "beta": beta,
            "beta_growth": beta_growth,
            "threshold": threshold,
            "units": units,
            "threads": threads,
            "window": window,
            "metric_scale": metric_scale,
            "metric_steps": metric_steps,
            "scheme": scheme,
            "clipping": clipping,
            "strength": strength,
        },
        fast=fast,
    )
    if space not in get_args(Space):
        raise UsageError(f"space is {space}, but must be {', '.join(get_args(Space))}")
    if encoding not in get_args(Encoding):
        raise UsageError(f"encoding is {encoding}, but must be {' or '.join(get_args(Encoding))}")
    if positions is not None and height is not None:
        raise UsageError("positions and height are two surfaces for one image; give one of them")
    image = ArrayImage(*pixel_colours(colours), encoding, space)
    EmbeddingSettings(  # which checks the weight
        guides=() if guide is None else ("guide",), guide_betas=() if guide_beta is None else (guide_beta,)
    )
    guides = []
    if guide is not None:
        values = centred(guide_table(guide, image.shape)).reshape(*image.shape, -1)
        guides = [GuideImage("guide", values, guide_beta)]
    image.require_channels(metric_channels)
    return image.smooth(
        None if valid is None else pixel_array(valid, "valid", image.shape, "bui").astype(bool),
        None if positions is None else pixel_array(positions, "positions", (*image.shape, None), "uif"),
        None if height is None else height_scale * pixel_array(height, "height", image.shape, "uif"),
        kernel,
        progress,
        guides,
        metric_channels,
    )
