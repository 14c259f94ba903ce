"""Smooth vertex colours: painted vertices in, new colours out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.flow.iteration import BeltramiFlow, FlowResult
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.mesh.painted import Encoding, PaintedVertices
from beltrami_cli.mesh.validation import check_mesh, check_numbers, colour_table, face_table, position_table
from beltrami_cli.pipeline.settings import DEFAULTS, SmoothSettings
from beltrami_cli.sampling.vertices import VertexSampling, sample_vertices

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from beltrami_cli.flow.parameters import Space, Units, Weights
    from beltrami_cli.mesh.surface import SampledSurface


@dataclass(frozen=True)
class SmoothResult:
    """Smoothed vertex colours, and how they came about.

    Attributes
    ----------
    colours : ndarray of float32, shape (V, C)
        In the same encoding and order as the input's. Vertices that did not change have the input's bits.
    beta : float
        As used, in units of length per unit of colour.
    spacing : float
        Mean edge length, in the unit of the positions; 0 without edges.
    noise : dict of str to float
        Estimated standard deviation of the noise for each smoothed channel, in the working space.
    samples : int
        Distinct samples: coincident vertices of one colour are one.
    hard_edge_samples : int
        Samples more than there are places: coincident vertices that differ in colour.
    samples_per_kernel : float
        Mean number of samples that a kernel held.
    truncated : int
        Kernels that `max_samples` cut short, over all iterations.
    """

    colours: NDArray[np.float32]
    beta: float
    spacing: float
    noise: dict[str, float]
    samples: int
    hard_edge_samples: int
    samples_per_kernel: float
    truncated: int


def smooth(
    positions: ArrayLike,
    faces: ArrayLike,
    colours: ArrayLike,
    *,
    iterations: int = DEFAULTS.kernel.iterations,
    t: float = DEFAULTS.kernel.t,
    beta: float | None = DEFAULTS.kernel.beta,
    threshold: float = DEFAULTS.kernel.threshold,
    weights: Weights = DEFAULTS.kernel.weights,
    units: Units = DEFAULTS.kernel.units,
    max_samples: int = DEFAULTS.kernel.max_samples,
    threads: int | None = DEFAULTS.kernel.threads,
    metric_scale: float = DEFAULTS.kernel.metric_scale,
    metric_steps: int = DEFAULTS.kernel.metric_steps,
    space: Space = DEFAULTS.space,
    encoding: Encoding = "srgb",
    progress: Callable[[int, int], None] | None = None,
) -> SmoothResult:
    """Smooth the colours of a triangle mesh with the short-time Beltrami kernel.

    Parameters
    ----------
    positions : array_like, shape (V, M)
        Vertex positions in any dimension M, finite.
    faces : array_like of int, shape (F, 3)
        Triangles as vertex indices; any set of triangles, non-manifold ones included.
    colours : array_like, shape (V, C) or (V,)
        Any number of channels, finite. uint8, uint16 and uint32 are taken by their full scale, floats as they are
        (full scale 1); other integers are refused, for their full scale is not known.
    iterations : int
        Number N of kernel iterations.
    t : float
        Time step, in squared units of length.
    beta : float or None
        Units of length per unit of colour; None: from the estimated noise. 0: a geodesic Gaussian.
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
    metric_steps : int
        ... in so many of the first iterations; the colours themselves are averaged.
    space : {"srgb", "linear", "oklab", "data"}
        What distances and averages of colours are taken in; "data": the numbers as they are.
    encoding : {"srgb", "linear"}
        What the numbers in `colours` mean.
    progress : callable, optional
        Called with the samples done so far and the samples to do; may raise to stop.

    Returns
    -------
    SmoothResult
        With ``colours`` of shape (V, C), float32.

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
    distance on the surface (X, beta I) in R^(M+C), from fast marching [2]_.

    References
    ----------
    .. [1] A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images and manifolds",
       IEEE Trans. Image Processing 16(6), 2007, doi:10.1109/TIP.2007.894253
    .. [2] R. Kimmel, J. A. Sethian, "Computing geodesic paths on manifolds", PNAS 95(15), 1998,
       doi:10.1073/pnas.95.15.8431
    """
    check_numbers(
        {
            "iterations": iterations,
            "max_samples": max_samples,
            "metric_steps": metric_steps,
            "threads": 1 if threads is None else threads,
        },
        {"t": t, "beta": 0 if beta is None else beta, "threshold": threshold, "metric_scale": metric_scale},
    )
    kernel = KernelParameters(
        iterations=iterations,
        t=t,
        beta=beta,
        threshold=threshold,
        weights=weights,
        units=units,
        max_samples=max_samples,
        threads=threads,
        metric_scale=metric_scale,
        metric_steps=metric_steps,
    )
    if encoding not in get_args(Encoding):
        raise UsageError(f"encoding is {encoding}, but must be {' or '.join(get_args(Encoding))}")
    places, shades = position_table(positions), colour_table(colours)
    names = ("red", "green", "blue") if shades.shape[1] == 3 else tuple(map(str, range(shades.shape[1])))
    painted = PaintedVertices(
        places,
        face_table(faces, len(places)),
        shades,
        names,
        encoding,
        str(np.asarray(colours).dtype),
    )
    if shades.shape[1] != 3 and space == "oklab":
        raise UsageError("the space oklab needs three channels")
    check_mesh(painted, "the arrays")
    return smooth_painted(painted, SmoothSettings(kernel, space), progress)


def smooth_painted(
    painted: PaintedVertices,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
) -> SmoothResult:
    """Smooth painted vertices, as `smooth` does with arrays.

    Parameters
    ----------
    painted : PaintedVertices
        As a document gives it.
    settings : SmoothSettings
        The kernel's parameters, the working space and the channels.
    progress : callable, optional
        As in `smooth`.

    Returns
    -------
    SmoothResult

    Raises
    ------
    UsageError
        If the settings name channels that are not there.
    """
    chosen, surface, sampling = prepare(painted, settings)
    flow = BeltramiFlow(surface, settings.kernel)
    before = surface.colours
    del surface  # the flow has its own order of everything, and a large mesh is not held twice
    result = flow.run(progress)
    colours = painted.colours.copy()
    colours[:, chosen] = _to_vertices(painted, settings, chosen, before, sampling, result)
    return SmoothResult(
        colours,
        result.beta,
        result.spacing,
        {painted.channels[i]: float(sigma) for i, sigma in zip(chosen, result.sigma, strict=True)},
        len(before),
        len(before) - sampling.places,
        result.samples_per_kernel,
        result.truncated,
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


def prepare(
    painted: PaintedVertices, settings: SmoothSettings
) -> tuple[list[int], SampledSurface, VertexSampling]:
    """Make the samples that the settings ask for.

    Returns
    -------
    chosen : list of int
        Columns of `painted.colours` that take part.
    surface : SampledSurface
        With these channels in the working space.
    sampling : VertexSampling
        The way back to vertices.
    """
    chosen = _chosen_channels(painted, settings)
    working = to_space(painted.colours[:, chosen], painted.encoding, settings.space)
    surface, sampling = sample_vertices(painted, working)
    return chosen, surface, sampling


def _to_vertices(
    painted: PaintedVertices,
    settings: SmoothSettings,
    chosen: list[int],
    samples: NDArray[np.float32],
    sampling: VertexSampling,
    flow: FlowResult,
) -> NDArray[np.float32]:
    before = painted.colours[:, chosen]
    back = from_space(flow.colours, painted.encoding, settings.space)
    # The way there and back is not exact: what did not change keeps its bits, and what did stays in range.
    if len(before):
        back = np.clip(back, before.min(axis=0), before.max(axis=0))
    changed = np.any(flow.colours != samples, axis=1)[sampling.sample_of]
    return np.where(changed[:, None], back[sampling.sample_of], before)


def _chosen_channels(painted: PaintedVertices, settings: SmoothSettings) -> list[int]:
    if settings.channels is None:
        return list(range(len(painted.channels)))
    chosen = []
    for name in settings.channels:
        fits = [i for i, channel in enumerate(painted.channels) if name.lower() in (channel, channel[0])]
        if not fits:
            raise UsageError(f"there is no channel {name}; the colours have {', '.join(painted.channels)}")
        chosen.append(fits[0])
    return sorted(set(chosen))
