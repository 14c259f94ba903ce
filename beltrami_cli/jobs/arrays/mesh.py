"""Smooth the colours of a triangle mesh or a cloud of points: arrays in, arrays out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beltrami_cli.arrays import Array, Float64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.jobs.arrays.arguments import (
    ARRAYS,
    array_of,
    colour_table,
    face_table,
    in_type_of,
    position_table,
    require_choice,
    settings_for,
)
from beltrami_cli.jobs.arrays.mesh_arrays import MeshArrays, mesh_arrays
from beltrami_cli.jobs.progress import PhaseProgress
from beltrami_cli.jobs.smoothing import Smoothed, smooth_layer
from beltrami_cli.layers.mesh_layer import MeshLayer
from beltrami_cli.layers.reports import VertexReport
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.surface.points import CloudCounts, count_cloud
from beltrami_cli.surface.precision import require_finite, require_scale
from beltrami_cli.surface.records import ColouredVertices, Encoding


@dataclass(frozen=True)
class SmoothResult:
    """Smoothed vertex colours, with the parameters used and statistics.

    Attributes
    ----------
    colours : ndarray, shape (V, C)
        In the type, encoding and order of the input; integers are rounded as in files, and lists of floats become
        float64. Of a mesh with opacity, that is the fourth channel. Vertices that did not change are bit-identical to
        the input.
    beta : float
        As used, in units of length per unit of colour; 0 if no colour enters the metric.
    spacing : float
        Mean edge length, in the unit of the positions; 0 without edges.
    noise : dict of str to float
        Estimated standard deviation of the noise for each channel that takes part, in the working space.
    samples : int
        Distinct samples: coincident vertices of one colour count as one.
    hard_edge_samples : int
        Number of samples minus number of distinct positions: coincident vertices that differ in colour.
    samples_per_kernel : float
        Mean number of samples in a kernel.
    truncated : int
        Number of kernels that `max_samples` truncated, over all iterations.
    iterations : int
        Number of iterations that were run.
    guide_betas : dict of str to float
        As used for each guide, in units of length per unit of the guide.
    positions : ndarray of float64, shape (V, 3), or None
        New positions, if they were smoothed. Vertices that did not move are bit-identical to the input.
    normal_noise, normal_beta : float or None
        If positions were smoothed: the estimated noise of the normals in radians, and the beta used for them, in units
        of length per radian.
    cloud : CloudCounts or None
        Counts of points, triangles and outliers, for points without faces.
    choice : Choice or None
        Parameters that were chosen from the data, and their estimated error, if any were.
    patches : float or None
        The share of the result that was taken from patches; None if only the kernel was run.
    wrong_samples : dict
        If any are outliers: their "count" and "share", and whether they were "replaced".
    """

    colours: Array
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
    patches: float | None = None
    wrong_samples: dict[str, Any] = field(default_factory=dict)


def smooth(
    positions: Any,
    faces: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    settings: SmoothSettings = DEFAULTS,
    *,
    encoding: Encoding = "srgb",
    guide: ArrayLike | None = None,
    progress: PhaseProgress | None = None,
    **overrides: Any,
) -> SmoothResult:
    """Smooth the colours of a triangle mesh, or of a cloud of points, with the short-time Beltrami kernel.

    Parameters
    ----------
    positions : array_like, shape (V, M), or a mesh
        Vertices in a space of any dimension M, finite. Or a whole mesh or cloud of points, with its triangles and
        colours: `MeshArrays`, ``trimesh.Trimesh`` or ``PointCloud``, Open3D's ``TriangleMesh`` or ``PointCloud`` (also
        of ``open3d.t``), or PyVista's ``PolyData``, whose colours are an array of uint8 in ``point_data``, the active
        one or else the first. Its opacity, a fourth channel, stays. The mesh is not changed; the result can be
        assigned to its colours.
    faces : array_like of int, shape (F, 3), or None
        Triangles as vertex indices; any set of triangles, non-manifold ones included. None: a cloud of points, M at
        most 3, which is triangulated locally around each point.
    colours : array_like, shape (V, C) or (V,)
        Colours of the vertices; may be left out for a mesh that has some. Any number of channels. Vertices with a
        number that is not finite are holes: they stay, and lend nothing to others. uint8, uint16 and uint32 are divided
        by their full scale, floats are used as they are (full scale 1); other integers are refused, since their full
        scale is unknown.
    settings : SmoothSettings
        The kernel's parameters, the working space and the embedding. By default the parameters of the kernel are chosen
        from the data, by the estimated error of the result.
    encoding : {"srgb", "linear"}
        Encoding of the numbers in `colours`.
    guide : array_like, shape (V, G) or (V,), optional
        Channels that enter the metric and are not smoothed, finite, such as normals or clean colours.
    progress : callable, optional
        Called with the number of samples done so far and the total; may raise to stop.
    **overrides
        Single parameters by name, such as ``iterations=3, beta=12``, which replace those in `settings` and are not
        chosen from the data. Channels in `metric_channels` may be given by number, and `noise` as an array of standard
        deviations, full scale 1, of shape (V,) or (V, C).

    Returns
    -------
    SmoothResult
        With ``colours`` of shape (V, C), of the type of the input; ``positions`` if these were smoothed; ``cloud`` for
        points without faces.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, the shape or type of an array is wrong, a face refers to a
        vertex that does not exist, or a mesh has no colours of vertices, or faces that are not triangles.
    InputError
        If positions are not finite, or positions and colours differ in number.

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
    positions, faces, colours, opacity = _unpacked(positions, faces, colours)
    vertices = _vertices_of(positions, faces, colours, encoding)
    shape = (len(vertices.positions),)
    settings, guides, noise = settings_for(settings, guide, vertices.channels, shape, overrides)
    dimensions = vertices.positions.shape[1]
    if settings.embedding.smooth_geometry and dimensions != 3:
        raise UsageError(f"smooth_geometry needs positions in 3 dimensions, not {dimensions}")
    if faces is None and dimensions > 3:
        raise UsageError(f"positions in {dimensions} dimensions need faces")
    rows = np.flatnonzero(np.isfinite(vertices.colours).all(axis=1))
    layer = MeshLayer(
        vertices=vertices.restricted_to(rows), settings=settings, fits_surface=faces is None,
        guides=[replace(guide, values=guide.values[rows]) for guide in guides],
        noise=None if noise is None else noise[rows],
    ).normalised()  # fmt: skip
    done = smooth_layer(layer, progress)
    stored = done.stored
    assert stored.colours is not None
    new = _with_rows(vertices.colours, rows, stored.colours)
    new = in_type_of(array_of(colours, "colours"), vertices.colours, new)
    if opacity is not None:
        new = np.concatenate([new, opacity], axis=1)
    moved = None if stored.positions is None else _with_rows(vertices.positions, rows, stored.positions)
    return _result(done, new, moved, count_cloud(layer.triangulated) if faces is None else None)


def _result(
    done: Smoothed, colours: Array, positions: Float64s | None, cloud: CloudCounts | None
) -> SmoothResult:
    report = done.report
    assert isinstance(report, VertexReport)
    counts, geometry = report.counts, report.geometry or {}
    return SmoothResult(
        colours=colours, beta=report.beta, spacing=report.spacing, noise=report.noise,
        samples=int(counts["samples"]), hard_edge_samples=int(counts["hard_edge_samples"]),
        samples_per_kernel=done.samples_per_kernel, truncated=int(counts["truncated_kernels"]),
        iterations=report.iterations, guide_betas=report.guides, positions=positions,
        normal_noise=geometry.get("normal_noise"), normal_beta=geometry.get("normal_beta"), cloud=cloud,
        choice=done.choice, patches=report.patches, wrong_samples=report.wrong_samples,
    )  # fmt: skip


def _with_rows(table: Array, rows: Array, new: Array) -> Array:
    """Return a table with new rows; the others are holes."""
    result = table.copy()
    result[rows] = new
    return result


def _unpacked(
    mesh: Any, faces: ArrayLike | None, colours: ArrayLike | None
) -> tuple[ArrayLike, ArrayLike | None, ArrayLike, Array | None]:
    """Return positions, faces and colours, given as arrays or as a mesh, and the opacity of a mesh, shape (V, 1)."""
    arrays, opacity = mesh_arrays(mesh), None
    if arrays is None:
        arrays = MeshArrays(mesh, faces)
    elif faces is not None:
        raise UsageError("a mesh has faces; give either a mesh or positions and faces")
    elif colours is None and arrays.colours is not None:
        colours = array_of(arrays.colours, "colours")
        if colours.ndim == 2 and colours.shape[1] == 4:
            colours, opacity = colours[:, :3], colours[:, 3:]
    if colours is None:
        raise UsageError("there are no colours of vertices; give them, or a texture to smooth_textured")
    return arrays.positions, arrays.faces, colours, opacity


def _vertices_of(
    positions: ArrayLike, faces: ArrayLike | None, colours: ArrayLike, encoding: Encoding
) -> ColouredVertices:
    """Check the arrays of a mesh, or of points; channels have names, or else their numbers."""
    require_choice("encoding", encoding)
    places, shades = position_table(positions), colour_table(colours)
    names = ("red", "green", "blue") if shades.shape[1] == 3 else tuple(map(str, range(shades.shape[1])))
    stored = str(np.asarray(colours).dtype)
    triangles = face_table([] if faces is None else faces, len(places))
    if len(places) != len(shades):
        raise InputError(ARRAYS, f"there are {len(places)} positions but {len(shades)} colours")
    require_finite(places, ARRAYS, "the position of vertex")
    require_scale(places, triangles, ARRAYS)
    return ColouredVertices(places, triangles, shades, names, encoding, stored)
