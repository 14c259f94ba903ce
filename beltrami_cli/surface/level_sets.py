"""Level sets sampled on a lattice as triangles, and the colours of their vertices.

Marching cubes [1]_ puts a vertex on every edge of the grid that the surface cuts. Where it passes close to a grid
point, up to six of them crowd there: slivers for the march, samples that are uneven, and colours that all come from the
same voxel, whose common noise no average removes. So all that crowd at a grid point become one vertex in the middle
[2]_. Edges then are between some 0.5 and 2 voxels long, and the noise of neighbours is nearly independent, as the
kernel takes it to be: there is one vertex for each voxel that the surface passes. Only vertices that triangles join are
put together, so that the two sides of a thin sheet stay apart. Colours come from the grid or from points nearby [3]_.

References
----------
.. [1] T. Lewiner, H. Lopes, A. W. Vieira, G. Tavares, "Efficient implementation of Marching Cubes' cases with
   topological guarantees", J. Graphics Tools 8(2), 2003, doi:10.1080/10867651.2003.10487582
.. [2] D. Moore, J. Warren, "Compact isocontours from sampled data", in: Graphics Gems III, 1992, pp. 23-28
.. [3] D. Shepard, "A two-dimensional interpolation function for irregularly-spaced data", Proc. ACM National Conference
   1968, doi:10.1145/800186.810616: the weights of the nearest points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s
from beltrami_cli.surface.geometry import edges_of, without_unused
from beltrami_cli.surface.grouping import connected
from beltrami_cli.surface.records import ColouredVertices, Encoding

# In units of the change of values across the surface: values nearer to the level are moved outside by this much, since
# marching cubes leaves holes where values equal the level.
_MIN_VALUE = 1e-6
# Bound beyond which exact values do not move a vertex; their products must fit float32.
_MAX_VALUE = 1e9
_LARGEST_EXPONENT = 1000  # exponent of a scale whose inverse is also finite
SLAB = 1 << 22  # voxels processed at a time in double precision, to bound memory

_NEIGHBOURS = 4  # points from which a vertex takes its colour, about those around it on a surface
_COLOUR_RADIUS = 4.0  # in voxels, or point spacings if larger
_PROBES = 10_000  # points whose spacing represents that of all to a per cent
_WEIGHTLESS = 1e-6  # below the weight of any contributing voxel


@dataclass(frozen=True)
class Lattice:
    """Positions of grid samples in space: sample (i, j, k) is at ``origin + (i, j, k) @ axes``."""

    # Shape (3, 3): row a is the step in space to the next sample along index a; invertible.
    axes: Float64s
    origin: Float64s  # (3,): position of sample (0, 0, 0), the centre of its voxel

    def in_space(self, at: Float64s) -> Float64s:
        """Convert points, shape (V, 3), from units of the lattice."""
        return np.asarray(self.origin + at @ self.axes)


@dataclass(frozen=True)
class GridColours:
    """Colours on a lattice, which may differ from that of the level set."""

    lattice: Lattice  # where they stand
    # Shape (X, Y, Z, C): numbers as stored, of any integer or floating type; C is 1 or 3, and one more if
    # there is opacity. Voxels with a number that is not finite, or of opacity 0, have no colour.
    samples: Array


@dataclass(frozen=True)
class NearColours:
    """Colours at points near the surface."""

    points: Float64s  # (P, 3): finite positions, in the space of the level set
    samples: Array  # (P, C): numbers as stored, as in `GridColours`
    encoding: Encoding = "srgb"  # what the numbers mean
    stored: str = ""  # type in the file if `samples` are of full scale 1; empty: that of `samples`

    @classmethod
    def of(cls, vertices: ColouredVertices) -> NearColours:
        return cls(vertices.positions, vertices.colours, vertices.encoding, vertices.stored)


@dataclass(frozen=True)
class Volume:
    lattice: Lattice  # where the samples stand
    # Shape (X, Y, Z): of any integer, floating or boolean type. Values that are not finite are unknown.
    values: Array
    known: Bools | None = None  # (X, Y, Z): false where the value is unknown; None: all known
    level: float | None = None  # value on the surface, if in the file
    colours: GridColours | NearColours | None = None  # colours of the surface, if in the file


def interpolate_colours(colours: GridColours, positions: Float64s, known: Bools | None = None) -> Float64s:
    """Interpolate stored colours trilinearly between the eight voxels around each position."""
    # Voxels without a colour, unknown or outside do not contribute; the weights of the others are normalised. NaN where
    # no voxel contributes.
    samples = colours.samples
    sides = np.array(samples.shape[:3])
    at = np.linalg.solve(colours.lattice.axes.T, (positions - colours.lattice.origin).T).T
    # A position on the grid must not take colour from a further voxel because of rounding.
    at = np.where(np.abs(at - np.rint(at)) < _WEIGHTLESS, np.rint(at), at)
    corner = np.floor(at)
    beyond = at - corner
    total = np.zeros((len(at), samples.shape[3]))
    weights = np.zeros(len(at))
    for step in product((0, 1), repeat=3):
        voxel = corner + step
        weight = np.where(step, beyond, 1 - beyond).prod(axis=1)
        inside = ((voxel >= 0) & (voxel < sides)).all(axis=1) & (weight > _WEIGHTLESS)
        index = tuple(voxel[inside].astype(np.intp).T)
        taken = samples[index].astype(np.float64)
        valid = has_colour(taken) if known is None else has_colour(taken) & known[index]
        rows = np.flatnonzero(inside)[valid]
        total[rows] += weight[rows, None] * taken[valid]
        weights[rows] += weight[rows]
    return _mean(total, weights)


def nearest_colours(colours: NearColours, positions: Float64s, voxel: float, threads: int) -> Float64s:
    """Take stored colours from the nearest points, weighted by inverse squared distance [3]."""
    # NaN where no point is within 4 voxels, or within 4 times the distance of a point to its fourth neighbour if that
    # is larger.
    from scipy.spatial import cKDTree

    samples = colours.samples.astype(np.float64)
    valid = has_colour(samples)
    if not valid.any():
        return np.full((len(positions), samples.shape[1]), np.nan)
    points, samples = colours.points[valid], samples[valid]
    tree, count = cKDTree(points), min(_NEIGHBOURS, len(points))
    probes = points[:: max(1, len(points) // _PROBES)]
    between = tree.query(probes, [min(count + 1, len(points))], workers=threads)[0]
    reach = _COLOUR_RADIUS * max(voxel, float(np.median(between)))
    distances, nearest = tree.query(positions, list(range(1, count + 1)), workers=threads)
    nearest = np.minimum(nearest, len(points) - 1)  # missing points have the weight 0
    with np.errstate(over="ignore"):
        # A minimum distance keeps the weight of a coincident point finite, and far above all others.
        weights = np.where(distances <= reach, 1 / (distances**2 + (1e-6 * voxel) ** 2), 0.0)
        total = (weights[..., None] * samples[nearest]).sum(axis=1)
    return _mean(total, weights.sum(axis=1))


def has_colour(samples: Float64s) -> Bools:
    """Return which rows, shape (V, C), are finite and not fully transparent."""
    coloured = np.asarray(np.isfinite(samples).all(axis=1), bool)
    if samples.shape[1] in (2, 4):
        coloured &= np.greater(samples[:, -1], 0)
    return coloured


def _mean(total: Float64s, weights: Float64s) -> Float64s:
    with np.errstate(invalid="ignore"):
        return np.where(weights[:, None] > 0, total / weights[:, None], np.nan)


@dataclass(frozen=True)
class Crossings:
    """Size of the surface of a level set before it is triangulated."""

    # Number of grid edges that it cuts, which are the vertices of marching cubes, apart from a few inside cells.
    count: int
    scale: float  # power of two near 1 / geometric mean of the change along these edges


def find_crossings(values: Array, level: float, known: Bools | None = None) -> Crossings:
    """Count the edges of a grid, shape (X, Y, Z), that a level set cuts; non-finite values are unknown."""
    count, total = 0, 0.0
    for first, stop in _slabs(values.shape, overlap=1):
        with np.errstate(over="ignore"):
            offsets = values[first:stop].astype(np.float64) - level
        if known is not None:
            offsets[~known[first:stop]] = np.nan
        for axis in range(3):
            # The last layer of a slab is the first of the next slab, which counts the edges within it.
            layers = offsets[:-1] if axis > 0 and stop < len(values) else offsets
            lower = np.take(layers, range(layers.shape[axis] - 1), axis)
            upper = np.take(layers, range(1, layers.shape[axis]), axis)
            cut = np.isfinite(lower) & np.isfinite(upper) & ((lower < 0) != (upper < 0))
            count += int(np.count_nonzero(cut))
            # Halves, since the difference of two doubles may overflow; at least the smallest positive number, since it
            # is not 0.
            change = np.maximum(np.abs(upper[cut] / 2 - lower[cut] / 2), np.finfo(float).smallest_subnormal)
            total += float((1 + np.log2(change)).sum())
    exponent = -round(total / count) if count else 0
    return Crossings(count, float(np.ldexp(1.0, max(-_LARGEST_EXPONENT, min(exponent, _LARGEST_EXPONENT)))))


def triangulate_level_set(
    values: Array, level: float, crossings: Crossings, known: Bools | None = None
) -> tuple[Float64s, Int32s]:
    """Triangulate a level set with crossings; return vertices in units of the grid, and faces."""
    # Faces are counter-clockwise seen from larger values. Cells with an unknown corner have no faces, which leaves
    # holes.
    from skimage.measure import marching_cubes

    offsets, cells = _prepared(values, level, crossings.scale, known)
    _require_memory(crossings.count, values.shape)
    try:
        # "descent" uses the left-hand rule: by the right-hand rule, triangles face larger values.
        vertices, faces, _, _ = marching_cubes(offsets, 0.0, gradient_direction="descent", mask=cells)
    except RuntimeError:  # no known cell is cut
        return np.empty((0, 3)), np.empty((0, 3), np.int32)
    return compacted(vertices.astype(np.float64), faces)


def _require_memory(crossings: int, shape: tuple[int, ...]) -> None:
    """Raise MemoryError if marching cubes could run out of memory: it overruns an array that it failed to enlarge."""
    # Its arrays of vertices (28 bytes) and corners (4 bytes) have lengths of powers of two, and are copied. A cell with
    # k cut edges, each shared by four cells, makes up to 9 k / 7 triangles, and an inner vertex if k is 7 or more.
    vertices = 1 << (11 * crossings // 7).bit_length()
    corners = 1 << (16 * crossings).bit_length()
    layers = 2 * 4 * 4 * shape[1] * shape[2]
    np.empty(2 * (28 * vertices + 4 * corners) + layers, np.uint8)


def _slabs(shape: tuple[int, ...], overlap: int) -> Iterator[tuple[int, int]]:
    """Split the first index into ranges of a bounded number of voxels, with overlapping layers."""
    thickness = max(1, SLAB // (shape[1] * shape[2]))
    for first in range(0, shape[0] - overlap, thickness):
        yield first, min(first + thickness + overlap, shape[0])


def _prepared(values: Array, level: float, scale: float, known: Bools | None) -> tuple[Float32s, Bools]:
    """Return the values relative to the level, and a mask of cells to process, at the last corner of each."""
    # The cell of (i, j, k) has its first corner at (i - 1, j - 1, k - 1), as in the masks of scikit-image.
    offsets = np.empty(values.shape, np.float32)
    finite = np.empty(values.shape, bool)
    for first, stop in _slabs(values.shape, overlap=0):
        with np.errstate(over="ignore", invalid="ignore"):
            exact = values[first:stop].astype(np.float64) - level
            finite[first:stop] = np.isfinite(exact)
            exact = np.clip(np.nan_to_num(exact * scale, nan=_MAX_VALUE), -_MAX_VALUE, _MAX_VALUE)
        offsets[first:stop] = np.where(
            np.abs(exact) < _MIN_VALUE, np.where(exact < 0, -_MIN_VALUE, _MIN_VALUE), exact
        )
    if known is not None:
        finite &= known
    for axis in range(3):  # a cell is known if its corners are
        later: list[slice] = [slice(None)] * 3
        earlier = list(later)
        later[axis], earlier[axis] = slice(1, None), slice(None, -1)
        finite[tuple(later)] &= finite[tuple(earlier)].copy()
    return offsets, finite


def compacted(vertices: Float64s, faces: Int32s) -> tuple[Float64s, Int32s]:
    """Merge vertices that edges join and whose nearest grid point is the same into their mean."""
    edges = edges_of(faces)
    nearest = np.rint(vertices)
    edges = edges[(nearest[edges[:, 0]] == nearest[edges[:, 1]]).all(axis=1)]
    group_of = connected(len(vertices), edges)
    members = np.bincount(group_of)
    middles = np.column_stack([np.bincount(group_of, column) / members for column in vertices.T])
    # Remove collapsed triangles, pairs of opposite ones, which bound nothing, and then unused vertices.
    faces = group_of[faces]
    ordered = np.sort(faces, axis=1)
    proper = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    faces, ordered = faces[proper], ordered[proper]
    _, first, uses = np.unique(ordered, axis=0, return_index=True, return_counts=True)
    faces = faces[np.sort(first[uses % 2 == 1])]
    return without_unused(middles, faces)
