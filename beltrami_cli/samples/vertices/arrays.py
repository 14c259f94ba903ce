"""Smooth the colours of a triangle mesh: arrays in, arrays out."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.embedding import Guide, centred
from beltrami_cli.flow.parameters import parameters_with
from beltrami_cli.samples.settings import DEFAULTS, EmbeddingSettings, SmoothSettings
from beltrami_cli.samples.vertices.point_cloud import smooth_cloud
from beltrami_cli.samples.vertices.smooth import smooth_painted
from beltrami_cli.surface.records import Encoding, PaintedVertices
from beltrami_cli.surface.validation import (
    check_mesh,
    check_numbers,
    colour_table,
    face_table,
    guide_table,
    position_table,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    from beltrami_cli.flow.parameters import Clipping, Solver, Space, Strength, Units, Weights
    from beltrami_cli.samples.vertices.result import SmoothResult


def smooth(
    positions: ArrayLike,
    faces: ArrayLike | None,
    colours: ArrayLike,
    *,
    iterations: int | None = None,
    t: float | None = None,
    beta: float | None = None,
    beta_growth: float | None = None,
    threshold: float = DEFAULTS.kernel.threshold,
    weights: Weights = DEFAULTS.kernel.weights,
    units: Units = DEFAULTS.kernel.units,
    max_samples: int = DEFAULTS.kernel.max_samples,
    threads: int | None = DEFAULTS.kernel.threads,
    metric_scale: float = DEFAULTS.kernel.metric_scale,
    metric_steps: int | None = None,
    clipping: Clipping = DEFAULTS.kernel.clipping,
    solver: Solver = DEFAULTS.kernel.solver,
    strength: Strength = DEFAULTS.kernel.strength,
    fast: bool = False,
    space: Space = DEFAULTS.space,
    encoding: Encoding = "srgb",
    guide: ArrayLike | None = None,
    guide_beta: float | None = None,
    metric_channels: Sequence[int] | None = None,
    smooth_geometry: bool = False,
    normal_beta: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SmoothResult:
    """Smooth the colours of a triangle mesh, or of a cloud of points, with the short-time Beltrami kernel.

    Parameters
    ----------
    positions : array_like, shape (V, M)
        Vertex positions in any dimension M, finite.
    faces : array_like of int, shape (F, 3), or None
        Triangles as vertex indices; any set of triangles, non-manifold ones included. None: a cloud of points, M at
        most 3, whose triangles are found around each point, see `triangulate_points`.
    colours : array_like, shape (V, C) or (V,)
        Any number of channels, finite. uint8, uint16 and uint32 are taken by their full scale, floats as they are
        (full scale 1); other integers are refused, for their full scale is not known.
    iterations : int, optional
        Number N of kernel iterations. It, `t`, `beta`, `beta_growth` and `metric_steps` are chosen from the data where
        they are not given, by the estimated error of the result; see `strength` and `fast`.
    t : float, optional
        Time step, in squared units of length.
    beta : float, optional
        Units of length per unit of colour. 0: a geodesic Gaussian.
    beta_growth : float, optional
        Factor, 1 or more, by which beta grows from one iteration to the next.
    threshold : float
        Samples with a kernel value below it are left out.
    weights : {"uniform", "area"}
        Count each sample once, or by the area it stands for.
    units : {"spacing", "world"}
        Unit of length: the mean length of the edges around, or that of `positions`.
    max_samples : int
        Largest number of samples in a kernel.
    threads : int or None
        None: all that the process may use. The result does not depend on it.
    metric_scale : float
        Take distances from colours smoothed by a Gaussian of this standard deviation, in sample spacings ...
    metric_steps : int, optional
        ... in so many of the first iterations; the colours themselves are averaged.
    clipping : {"restore", "keep"}
        Whether averages are corrected where noise was cut off at 0 or full scale.
    solver : {"auto", "fast-marching", "segments"}
        How distances are found: by fast marching, or along segments over edges and one or two unfolded edges.
    strength : {"gentle", "normal", "strong"}
        Whether what is chosen smooths less or more than what is estimated to be best.
    fast : bool
        Whether parameters that are not given follow a fixed rule instead, which takes no time.
    space : {"srgb", "linear", "oklab", "data"}
        What distances and averages of colours are taken in; "data": the numbers as they are.
    encoding : {"srgb", "linear"}
        What the numbers in `colours` mean.
    guide : array_like, shape (V, G) or (V,), optional
        Channels that enter the metric and stay as they are, finite, such as normals or clean colours.
    guide_beta : float or None
        Units of length per unit of the guide; None: from the guide, see `choose_guide_beta`.
    metric_channels : sequence of int, optional
        Which colour channels enter the metric; without it all. Empty: only the surface and the guide do.
    smooth_geometry : bool
        Whether the positions are smoothed along with the colours, but for those on a boundary. M must be 3.
    normal_beta : float or None
        Units of length per radian that the normal turns: how strongly creases of a smoothed geometry are kept; None:
        from the estimated noise of the normals.
    progress : callable, optional
        Called with the samples done so far and the samples to do; may raise to stop.

    Returns
    -------
    SmoothResult
        With ``colours`` of shape (V, C), float32; ``positions`` if these were smoothed; ``cloud`` without faces.

    Raises
    ------
    UsageError
        If a parameter is out of its range, an array's shape or type does not fit, or a face names a vertex that is
        not there.
    InputError
        If positions or colours are not finite, or are not of the same number.

    Notes
    -----
    Each iteration averages with the kernel exp(-d^2 / (4 t)), eqs. (8, 9) of [1]_, where d is the geodesic
    distance on the surface (X, beta I) in R^(M+C), from fast marching [2]_ or along segments.

    References
    ----------
    .. [1] A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images and manifolds",
       IEEE Trans. Image Processing 16(6), 2007, doi:10.1109/TIP.2007.894253
    .. [2] R. Kimmel, J. A. Sethian, "Computing geodesic paths on manifolds", PNAS 95(15), 1998,
       doi:10.1073/pnas.95.15.8431
    """
    betas = {"beta": beta, "guide_beta": guide_beta, "normal_beta": normal_beta}
    check_numbers(
        {
            "iterations": 0 if iterations is None else iterations,
            "max_samples": max_samples,
            "metric_steps": 0 if metric_steps is None else metric_steps,
            "threads": 1 if threads is None else threads,
        },
        {
            "t": 1 if t is None else t,
            "threshold": threshold,
            "metric_scale": metric_scale,
            "beta_growth": 1 if beta_growth is None else beta_growth,
            **{name: 0 if value is None else value for name, value in betas.items()},
        },
    )
    kernel = parameters_with(
        {
            "iterations": iterations,
            "t": t,
            "beta": beta,
            "beta_growth": beta_growth,
            "threshold": threshold,
            "weights": weights,
            "units": units,
            "max_samples": max_samples,
            "threads": threads,
            "metric_scale": metric_scale,
            "metric_steps": metric_steps,
            "clipping": clipping,
            "solver": solver,
            "strength": strength,
        },
        fast=fast,
    )
    painted = _painted(positions, faces, colours, encoding)
    if len(painted.channels) != 3 and space == "oklab":
        raise UsageError("the space oklab needs three channels")
    if smooth_geometry and painted.positions.shape[1] != 3:
        raise UsageError(f"smooth_geometry needs positions in 3 dimensions, not {painted.positions.shape[1]}")
    if faces is None and painted.positions.shape[1] > 3:
        raise UsageError(f"positions in {painted.positions.shape[1]} dimensions need faces")
    embedding = EmbeddingSettings(
        guides=() if guide is None else ("guide",),
        guide_betas=() if guide_beta is None else (guide_beta,),
        metric_channels=None if metric_channels is None else _names(metric_channels, painted),
        smooth_geometry=smooth_geometry,
        normal_beta=normal_beta,
    )
    guides = []
    if guide is not None:
        guides = [Guide("guide", centred(guide_table(guide, (len(painted.positions),))), guide_beta)]
    job = smooth_cloud if faces is None else smooth_painted
    return job(painted, SmoothSettings(kernel, space, embedding=embedding), progress, guides)


def _painted(
    positions: ArrayLike, faces: ArrayLike | None, colours: ArrayLike, encoding: Encoding
) -> PaintedVertices:
    if encoding not in get_args(Encoding):
        raise UsageError(f"encoding is {encoding}, but must be {' or '.join(get_args(Encoding))}")
    places, shades = position_table(positions), colour_table(colours)
    names = ("red", "green", "blue") if shades.shape[1] == 3 else tuple(map(str, range(shades.shape[1])))
    stored = str(np.asarray(colours).dtype)
    triangles = face_table([] if faces is None else faces, len(places))
    painted = PaintedVertices(places, triangles, shades, names, encoding, stored)
    check_mesh(painted, "the arrays")
    return painted


def _names(metric_channels: Sequence[int], painted: PaintedVertices) -> tuple[str, ...]:
    for channel in metric_channels:
        if not isinstance(channel, (int, np.integer)) or not 0 <= channel < len(painted.channels):
            raise UsageError(
                f"metric_channels names {channel!r}, but the {len(painted.channels)} channels count from 0"
            )
    return tuple(painted.channels[channel] for channel in metric_channels)
