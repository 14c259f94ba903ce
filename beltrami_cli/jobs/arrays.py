"""Smooth the colours of triangle meshes, textures, clouds of points and images: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beltrami_cli.arrays import Array
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.jobs.array_arguments import (
    MeshArrays,
    array_of,
    checked_surface,
    image_array,
    in_type_of,
    mesh_arrays,
    pixel_colours,
    require_choice,
    settings_for,
    textured_surface,
    textures_of,
    unpacked,
    vertices_of_arrays,
)
from beltrami_cli.jobs.smoothing import smooth_layer
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.layer import SlotReport, VertexReport
from beltrami_cli.layers.settings import DEFAULTS, LevelSettings, SmoothSettings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.vertex_layer import CloudCounts, GridLayer, MeshLayer, count_cloud, restricted_to
from beltrami_cli.surface.records import ColouredVertices, Encoding, Slot

Progress = Callable[[int, int], None]


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


def smooth(
    positions: Any,
    faces: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    settings: SmoothSettings = DEFAULTS,
    *,
    encoding: Encoding = "srgb",
    guide: ArrayLike | None = None,
    progress: Progress | None = None,
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
    positions, faces, colours, opacity = unpacked(positions, faces, colours)
    vertices = vertices_of_arrays(positions, faces, colours, encoding)
    shape = (len(vertices.positions),)
    settings, guides, noise = settings_for(settings, guide, vertices.channels, shape, overrides)
    dimensions = vertices.positions.shape[1]
    if settings.embedding.smooth_geometry and dimensions != 3:
        raise UsageError(f"smooth_geometry needs positions in 3 dimensions, not {dimensions}")
    if faces is None and dimensions > 3:
        raise UsageError(f"positions in {dimensions} dimensions need faces")
    rows = np.flatnonzero(np.isfinite(vertices.colours).all(axis=1))
    layer = MeshLayer(
        vertices=restricted_to(vertices, rows), settings=settings, fits_surface=faces is None,
        guides=[replace(guide, values=guide.values[rows]) for guide in guides],
        noise=None if noise is None else noise[rows],
    ).normalised()  # fmt: skip
    done = smooth_layer(layer, progress)
    report, stored = done.report, done.stored
    assert isinstance(report, VertexReport)
    assert stored.colours is not None
    counts, geometry = report.counts, report.geometry or {}
    after = _with_rows(vertices.colours, rows, stored.colours)
    moved = stored.positions
    moved = None if moved is None else _with_rows(vertices.positions, rows, moved)
    new = in_type_of(array_of(colours, "colours"), vertices.colours, after)
    new = new if opacity is None else np.concatenate([new, opacity], axis=1)
    return SmoothResult(
        colours=new, beta=report.beta, spacing=report.spacing, noise=report.noise,
        samples=int(counts["samples"]), hard_edge_samples=int(counts["hard_edge_samples"]),
        samples_per_kernel=done.samples_per_kernel, truncated=int(counts["truncated_kernels"]),
        iterations=report.iterations, guide_betas=report.guides, positions=moved,
        normal_noise=geometry.get("normal_noise"), normal_beta=geometry.get("normal_beta"),
        cloud=count_cloud(layer.joined) if faces is None else None, choice=done.choice, patches=report.patches,
        wrong_samples=report.wrong_samples,
    )  # fmt: skip


def _with_rows(table: Array, rows: Array, new: Array) -> Array:
    """Return a table with new rows; the others are holes."""
    result = table.copy()
    result[rows] = new
    return result


def smooth_image(
    colours: ArrayLike,
    settings: SmoothSettings = DEFAULTS,
    *,
    surface: ImageSurface | None = None,
    encoding: Encoding = "srgb",
    guide: ArrayLike | None = None,
    progress: Progress | None = None,
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
    table, shape = pixel_colours(given)
    channels = tuple(map(str, range(table.shape[1])))
    settings, guides, noise = settings_for(settings, guide, channels, shape, overrides)
    require_choice("encoding", encoding)
    place = checked_surface(surface, table, shape)
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


@dataclass(frozen=True)
class TexturedResult:
    """Smoothed textures, with the parameters used and statistics.

    Attributes
    ----------
    images : list of ndarray
        In the shape, type and encoding of the input; what did not change is bit-identical to it.
    report : SlotReport
        Parameters, noise, change and statistics, as in the report of a file.
    warnings : list of str
        Messages for the user, such as that no texel is covered by the surface.
    """

    images: list[Array]
    report: SlotReport
    warnings: list[str]


def smooth_textured(
    mesh: Any,
    images: Sequence[ArrayLike] | None = None,
    settings: SmoothSettings = DEFAULTS,
    *,
    texture_of: ArrayLike | None = None,
    origin: Literal["lower", "upper"] = "lower",
    slot: Slot = "baseColor",
    encoding: Encoding = "srgb",
    progress: Callable[[int, int], None] | None = None,
    **overrides: Any,
) -> TexturedResult:
    """Smooth the textures of a mesh over its surface, across their seams, with the short-time Beltrami kernel.

    Parameters
    ----------
    mesh : MeshArrays or trimesh.Trimesh
        Triangles with texture coordinates; beyond 0 and 1 these repeat the image.
    images : sequence of array_like, shape (H, W) or (H, W, C), optional
        Textures of one slot, by default the image of the mesh: grey or RGB, with opacity or without, row 0 the upper
        one. Types as for `smooth`, all finite. Texels of opacity 0 supply no colour.
    settings : SmoothSettings
        As for `smooth`. Settings that choose parts of a file, or how files are written, have no effect.
    texture_of : array_like of int, shape (F,), optional
        Index of each face's image, -1 for none; needed with several images.
    origin : {"lower", "upper"}
        The edge of the image where v is 0: lower as in OBJ, trimesh, Open3D and Blender, upper as in glTF.
    slot : {"baseColor", "emissive", "normal", "occlusion", "metallicRoughness"}
        What the images are of; the last three are data rather than colours.
    encoding : {"srgb", "linear"}
        Encoding of colours.
    progress : callable, optional
        As for `smooth`.
    **overrides
        As for `smooth`, with channels named "red", "green", "blue" or "grey"; no arrays of noise.

    Returns
    -------
    TexturedResult
        With ``images`` in the shapes and types of the input.

    Raises
    ------
    UsageError
        If a parameter is unknown, out of its range or only for files, the shape or type of an array is wrong, or a
        vertex or image with a number does not exist.
    InputError
        If positions, texture coordinates or images are not finite.
    """
    settings = override(settings, **overrides)
    guides, noise = settings.embedding.guides, settings.kernel.given_noise
    if guides or settings.embedding.smooth_geometry or (noise is not None and noise.source):
        raise UsageError("smooth_textured takes no guides, files of noise or smooth_geometry")
    require_choice("slot", slot, get_args(Slot))
    arrays = mesh_arrays(mesh) or MeshArrays(mesh)
    if images is None:
        images = [] if arrays.image is None else [arrays.image]
    given = [image_array(image, f"image {number}") for number, image in enumerate(images)]
    pictures = textures_of(given, encoding)
    names = [picture.name for picture in pictures]
    surface = textured_surface(arrays, names, texture_of, origin)
    # Images that other slots show, too, are handed back as pixels, not as files: here all of them.
    layer = TextureLayer.read(surface, slot, settings, shared=names, decoded=pictures)
    done = smooth_layer(layer.levelled(LevelSettings()) if settings.level_seams else layer, progress)
    assert isinstance(done.report, SlotReport)
    smoothed = [
        in_type_of(old, picture.pixels, new.pixels).reshape(old.shape)
        for old, picture, new in zip(given, pictures, done.stored.shared, strict=True)
    ]
    return TexturedResult(smoothed, done.report, [*done.warnings, *done.stored.notices])
