"""Areas, normals, boundary and counts of triangle meshes; and polygons cut into triangles.

Triangles stay as they are. A quad is cut along the diagonal that inverts neither triangle, the shorter one if both do
not. Larger polygons become fans around their first corner where that inverts no triangle, which includes all convex
ones; the others lose ears [4]_ in the plane of Newell's normal [3]_. Where a polygon crosses itself there is no right
answer, but the count is still n - 2.

References
----------
.. [1] G. Thuermer, C. Wuethrich, "Computing vertex normals from polygonal facets", Journal of Graphics Tools 3(1),
   1998, doi:10.1080/10867651.1998.10487487: triangles weighted by their angle at the vertex, so that it does not matter
   how a face is cut.
.. [2] M. Garland, P. Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997,
   doi:10.1145/258734.258849
.. [3] M. E. Newell, R. G. Newell, T. L. Sancha, "A solution to the hidden surface problem", ACM 1972: the
   normal of a polygon that need not be flat.
.. [4] G. H. Meisters, "Polygons have ears", Amer. Math. Monthly 82 (1975). https://doi.org/10.2307/2319703
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import typical_edge, upper_median


def bounds(positions: Float64s) -> list[list[float]]:
    """Return the minimum and maximum coordinates; empty without positions."""
    return [positions.min(axis=0).tolist(), positions.max(axis=0).tolist()] if len(positions) else []


def unit_vectors(vectors: Float64s) -> Float64s:
    """Normalise vectors, shape (N, 3); zero vectors remain 0."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
    beyond = np.isinf(length[:, 0])  # squares of finite numbers may overflow
    if beyond.any():
        vectors = vectors.copy()
        vectors[beyond] /= np.abs(vectors[beyond]).max(axis=1, keepdims=True)
        length[beyond] = np.linalg.norm(vectors[beyond], axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))


def centred(positions: Float64s) -> Float64s:
    """Centre and scale points so that the furthest is at 1/2 to 1, and squares neither underflow nor overflow."""
    if not len(positions):
        return positions
    # Halves, since a sum may overflow; a power of two, since it does not round.
    points = positions / 2 - (positions.min(axis=0) / 2 + positions.max(axis=0) / 2) / 2
    extent = float(np.abs(points).max())
    return np.asarray(np.ldexp(points, -int(np.frexp(extent)[1]))) if extent > 0 else points


def shortest_type(positions: Float64s) -> Float32s | Float64s:
    """Return positions as float32 if exact, to save memory and digits in files."""
    with np.errstate(over="ignore"):  # Beyond float32 they become infinite, which is not equal.
        single = positions.astype(np.float32)
    return single if bool((single == positions).all()) else positions


# Steps of stored positions larger than this share of an edge bend the surface; half a step is rounded away.
_COARSE = 0.25


def coarse_rounding(positions: Float64s, faces: Int32s) -> list[str]:
    """Return a notice if single precision has rounded positions about as coarsely as the vertex spacing, else "".

    The stored type is inferred from the numbers: doubles have more digits than single precision holds.
    """
    edge = typical_edge(positions, faces)
    if edge == 0 or shortest_type(positions).dtype != np.float32:
        return []
    # The median vertex, since a single vertex may be anywhere.
    step = float(np.spacing(np.float32(upper_median(np.abs(positions).max(axis=1)))))
    if step < _COARSE * edge:
        return []
    return [
        f"Positions are rounded to steps of {step:.2g} in single precision, {step / edge:.2g} times the median edge: "
        "store them in double precision, or subtract an offset before they are stored."
    ]


def triangle_areas(positions: Float64s, faces: Int32s) -> Float64s:
    """Compute the areas of triangles in any dimension from the Gram determinant."""
    p = positions[faces[:, 1]] - positions[faces[:, 0]]
    q = positions[faces[:, 2]] - positions[faces[:, 0]]
    gram = (p * p).sum(1) * (q * q).sum(1) - (p * q).sum(1) ** 2
    return np.asarray(0.5 * np.sqrt(np.maximum(gram, 0)))


def vertex_areas(positions: Float64s, faces: Int32s) -> Float32s:
    """Compute the area of each vertex: a third of that of its triangles."""
    # In units of the mean over all vertices; 0 at isolated vertices.
    third = np.repeat(triangle_areas(positions, faces) / 3, 3)
    areas = np.bincount(faces.ravel(), third, len(positions))
    mean = areas.mean() if len(areas) else 0.0
    return (areas / mean if mean > 0 else areas).astype(np.float32)


# Remainder by rounding of the normals of opposite triangles, relative to their sum of sizes.
_CANCELLED = 1e-12


def vertex_normals(positions: Float64s, faces: Int32s, group_of: Int32s) -> Float32s:
    """Compute the unit normal of the triangles around each vertex; 0 where they cancel."""
    # Weights are the angle [1] and the square root of the area, since normals of slivers are mostly noise. Vertices
    # with equal numbers in `group_of`, such as copies of a split vertex, share a normal.
    crosses = _double_areas(positions, faces)
    area = np.linalg.norm(crosses, axis=1)
    root = np.sqrt(area)[:, None]
    parts = np.column_stack([np.divide(crosses, root, out=np.zeros_like(crosses), where=root > 0), root])
    angles = _angles(positions, faces, area)
    sums = _sums_over_groups(
        np.concatenate([angles[:, [corner]] * parts for corner in range(3)]), faces, group_of
    )
    length = np.linalg.norm(sums[:, :3], axis=1)
    known = length > _CANCELLED * sums[:, 3]
    normals = np.divide(sums[:, :3], length[:, None], out=np.zeros((len(sums), 3)), where=known[:, None])
    return np.asarray(normals[group_of], np.float32)


def normal_tensors(positions: Float64s, faces: Int32s, group_of: Int32s) -> Float64s:
    """Return the area-weighted sum of n n^T over the triangles around each group: the quadric of [2]."""
    # The largest eigenvalue is 1. On a plane the tensor is the projector on its normal, on a crease that on the plane
    # of both normals, and at a corner of a cube the identity. It is 0 without area.
    crosses = _double_areas(positions, faces)
    area = np.linalg.norm(crosses, axis=1, keepdims=True)
    normals = np.divide(crosses, area, out=np.zeros_like(crosses), where=area > 0)
    products = (crosses[:, :, None] * normals[:, None, :]).reshape(-1, 9)
    tensors = _sums_over_groups(np.tile(products, (3, 1)), faces, group_of).reshape(-1, 3, 3)
    largest = np.linalg.eigvalsh(tensors)[:, -1:, None]
    return np.asarray(np.divide(tensors, largest, out=np.zeros_like(tensors), where=largest > 0), np.float64)


def _double_areas(positions: Float64s, faces: Int32s) -> Float64s:
    """Return the normal of each triangle, with twice its area as length, shape (F, 3)."""
    corners = positions[faces]
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _angles(positions: Float64s, faces: Int32s, double_area: Float64s) -> Float64s:
    """Return the angles of triangles at their corners, shape (F, 3), in radians."""
    angles = np.empty((len(faces), 3))
    for corner in range(3):
        origin = positions[faces[:, corner]]
        one = positions[faces[:, (corner + 1) % 3]] - origin
        other = positions[faces[:, (corner + 2) % 3]] - origin
        angles[:, corner] = np.arctan2(double_area, np.einsum("fi,fi->f", one, other))
    return angles


def _sums_over_groups(values: Float64s, faces: Int32s, group_of: Int32s) -> Float64s:
    """Sum corner values, shape (3 F, N), all first corners first, over groups of vertices, shape (G, N)."""
    groups = group_of[faces].T.ravel()
    count = int(group_of.max(initial=-1)) + 1
    return np.stack([np.bincount(groups, column, count) for column in values.T], axis=1)


def on_boundary(faces: Int32s, count: int) -> Bools:
    """Return which vertices are ends of a boundary edge."""
    edges, uses = _edge_uses(_distinct(_without_degenerate(faces)), count)
    alone = edges[uses == 1]
    boundary = np.zeros(count, bool)
    boundary[alone // max(1, count)] = True
    boundary[alone % max(1, count)] = True
    return boundary


def _without_degenerate(faces: Int32s) -> Int64s:
    """Return the triangles without repeated vertices, their corners sorted."""
    corners = np.sort(faces.astype(np.int64), axis=1)
    is_proper = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    return np.asarray(corners[is_proper], np.int64)


def _distinct(corners: Int64s) -> Int64s:
    """Return each triangle once, with sorted corners."""
    return corners[group_equal_rows(*corners.T)[1]]


def _edge_uses(corners: Int64s, count: int) -> tuple[Int64s, Int64s]:
    """Return the edges of triangles, as low * count + high, and the number of triangles of each."""
    keys = np.concatenate([corners[:, i] * count + corners[:, j] for i, j in ((0, 1), (0, 2), (1, 2))])
    edges, uses = np.unique(keys, return_counts=True)
    return edges, uses


def count_topology(positions: Float64s, faces: Int32s) -> dict[str, int]:
    """Count the elements of a triangle mesh, by name; duplicate faces count once for the edges."""
    count, proper = len(positions), _without_degenerate(faces)
    distinct = _distinct(proper)
    _, uses = _edge_uses(distinct, count)
    flat = np.count_nonzero(triangle_areas(positions, proper.astype(np.int32)) == 0)
    return {
        "edges": len(uses),  # distinct ones
        "boundary_edges": int(np.count_nonzero(uses == 1)),  # with one triangle
        "non_manifold_edges": int(np.count_nonzero(uses > 2)),
        "degenerate_faces": len(faces) - len(proper) + int(flat),  # triangles without area
        "duplicate_faces": int(len(proper) - len(distinct)),  # with the same three vertices as an earlier one
        "isolated_vertices": count - len(np.unique(faces)),  # in no triangle
    }


# Number of averages over neighbours: enough to be steady where edge lengths vary at random, few enough to follow a
# gradation of the mesh.
_SMOOTHING_ROUNDS = 3


def mean_side(positions: Float64s, faces: Int32s) -> float:
    """Return the mean side length of all triangles; 1 without any."""
    corners = positions[faces]
    sides = corners - np.roll(corners, 1, axis=1)
    return float(np.sqrt((sides**2).sum(axis=2)).mean()) if len(corners) else 1.0


def distinct_edges(faces: Int32s) -> Int32s:
    """Return the edges of triangles or pairs, each once, shape (E, 2), sorted, lower end first."""
    sides = 3 if faces.shape[1] == 3 else 1
    pairs = large_arrays.empty(sides * len(faces), np.int64)
    for corner, keys in enumerate(np.split(pairs, sides)):
        ends = faces[:, corner], faces[:, corner - 1]
        np.minimum(*ends, out=keys)
        keys <<= 32
        keys |= np.maximum(*ends)
    pairs.sort()
    is_edge = np.ones(len(pairs), bool)
    for block in large_arrays.blocks(len(pairs)):
        # A triangle with a repeated vertex has a side without length.
        is_edge[block] = (pairs[block] >> 32).astype(np.int32) != pairs[block].astype(np.int32)
    is_edge[1:] &= pairs[1:] != pairs[:-1]
    edges = large_arrays.empty((int(np.count_nonzero(is_edge)), 2), np.int32)
    first = 0
    for block in large_arrays.blocks(len(pairs)):
        keys = pairs[block][is_edge[block]]
        edges[first : first + len(keys)] = np.stack([keys >> 32, keys], axis=1)
        first += len(keys)
    return edges


def edges_in_space(edges: Int32s, positions: Float64s) -> tuple[Int32s, Float64s]:
    """Return the edges whose ends differ in position, shape (L, 2), and their lengths."""
    lengths: Float64s = large_arrays.zeros(len(edges), np.float64)
    for block in large_arrays.blocks(len(edges)):
        low, high = edges[block].T
        for column in positions.T:
            lengths[block] += (column[low] - column[high]) ** 2
    np.sqrt(lengths, out=lengths)
    long = lengths > 0
    return (edges, lengths) if long.all() else (edges[long], lengths[long])


def local_spacing(count: int, edges: Int32s, lengths: Float64s) -> Float64s:
    """Return the mean edge length around each vertex, shape (count,), smoothed over neighbours."""
    if not len(edges):
        return np.ones(count)
    degree = np.bincount(edges.ravel(), minlength=count)
    total = np.bincount(edges[:, 0], lengths, count) + np.bincount(edges[:, 1], lengths, count)
    # Isolated vertices get the overall mean.
    spacing: Float64s = np.where(degree > 0, total / np.maximum(degree, 1), lengths.mean())
    for _ in range(_SMOOTHING_ROUNDS):
        around = np.bincount(edges[:, 0], spacing[edges[:, 1]], count)
        around = around + np.bincount(edges[:, 1], spacing[edges[:, 0]], count)
        spacing = np.asarray((spacing + around) / (degree + 1), np.float64)
    return spacing


_BLOCK = 1 << 16  # polygons processed at a time, to bound memory
_MAX_EARS = 1 << 14  # corners of a concave polygon, for at most ten seconds of work


def triangulate(positions: Float64s, corners: Int32s, offsets: Int64s) -> Int32s:
    """Cut polygons into triangles of the same orientation, in order: n - 2 per n corners, without new vertices."""
    # Polygon p has the corners ``corners[offsets[p]:offsets[p + 1]]``.
    sizes = np.diff(offsets)
    if sizes.size and (sizes == 3).all():
        return corners.reshape(-1, 3)
    rows = np.concatenate([[0], np.cumsum(np.maximum(sizes - 2, 0))])
    faces = np.empty((int(rows[-1]), 3), np.int32)
    for size in np.unique(sizes[sizes >= 3]).tolist():
        chosen = np.flatnonzero(sizes == size)
        for first in range(0, len(chosen), _BLOCK):
            block = chosen[first : first + _BLOCK, None]
            polygons = corners[offsets[block] + np.arange(size)]
            with np.errstate(over="ignore", invalid="ignore"):  # Areas of huge polygons count as no area.
                faces[rows[block] + np.arange(size - 2)] = _cut(positions, polygons)
    return faces


def triangulate_corners(positions: Float64s, corners: Int32s, offsets: Int64s) -> tuple[Int32s, Int64s]:
    """Cut polygons like `triangulate`; return indices into `corners`, and the polygon of each triangle."""
    every = np.arange(len(corners), dtype=np.int32)
    if (np.diff(offsets) == 3).all():
        return every.reshape(-1, 3), np.arange(len(offsets) - 1)
    cut = triangulate(positions[corners], every, offsets)
    return cut, np.searchsorted(offsets, cut[:, 0], side="right") - 1


def polygons_of(offsets: Int64s) -> Int64s:
    """Return the polygon of every corner."""
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def polygons_with(marked: Bools, offsets: Int64s) -> Bools:
    """Return which polygons have a marked corner."""
    return np.bincount(polygons_of(offsets)[marked], minlength=len(offsets) - 1) > 0


def dual(positions: Float64s, corners: Int32s, offsets: Int64s) -> tuple[Float64s, Int32s]:
    """Return the centroids of P polygons, shape (P, 3), and triangles that join those around each vertex."""
    sizes, polygon = np.diff(offsets), polygons_of(offsets)
    sums = [np.bincount(polygon, column, len(sizes)) for column in positions[corners].T]
    centroids = np.column_stack(sums) / np.maximum(sizes, 1)[:, None]
    place = group_equal_rows(*positions.T)[0][corners].astype(np.int64)
    after = np.arange(1, len(corners) + 1)
    after[offsets[1:][sizes > 0] - 1] = offsets[:-1][sizes > 0]
    # The polygon across the edge from a corner to the next has this edge in the opposite direction.
    edges, reverse = (a * len(positions) + b for a, b in ((place, place[after]), (place[after], place)))
    order = np.argsort(edges, kind="stable")
    match = order[np.minimum(np.searchsorted(edges, reverse, sorter=order), len(order) - 1)]
    first = np.empty(len(positions), np.int64)
    first[place[::-1]] = polygon[::-1]
    fans = np.column_stack([first[place], polygon[match], polygon])[edges[match] == reverse]
    a, b, c = fans.T
    return centroids, fans[(a != b) & (b != c) & (c != a)].astype(np.int32)


def unrolled(strips: Int64s, ends: Int64s) -> Int64s:
    """Convert triangle strips, which -1 restarts, to triangles; every second one of a strip is reversed."""
    if strips.size < 3:
        return np.empty((0, 3), np.int64)
    begins = np.zeros(len(strips), np.bool_)
    begins[ends[:-1][ends[:-1] < len(strips)]] = True
    begins[1:] |= strips[:-1] == -1
    numbers = np.arange(len(strips))
    since = numbers - np.maximum.accumulate(np.where(begins, numbers, 0))
    triangles = np.column_stack([strips[:-2], strips[1:-1], strips[2:]])
    odd = since[2:] % 2 == 1
    triangles[odd] = triangles[odd][:, [0, 2, 1]]
    a, b, c = triangles.T
    proper = (since[2:] >= 2) & (triangles >= 0).all(axis=1) & (a != b) & (b != c) & (c != a)
    return np.asarray(triangles[proper])


def _cut(positions: Float64s, polygons: Int32s) -> Int32s:
    """Cut polygons of one size, shape (P, n), into triangles of shape (P, n - 2, 3)."""
    size = polygons.shape[1]
    if size == 3:
        return polygons[:, None, :]
    # Relative to the first corner, so that products keep their digits far from the origin.
    points = positions[polygons] - positions[polygons[:, :1]]
    if size == 4:
        return _cut_quads(points, polygons)
    fan = np.column_stack([np.zeros(size - 2, np.intp), np.arange(1, size - 1), np.arange(2, size)])
    cut = polygons[:, fan]
    normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    areas = np.einsum("pfi,pi->pf", np.cross(points[:, 1:-1], points[:, 2:]), normals)
    for bad in np.flatnonzero((areas < 0).any(axis=1)).tolist():
        if size > _MAX_EARS:
            cause = f"a polygon of {size} corners is not convex; up to {_MAX_EARS} are cut into triangles"
            raise InputError("the mesh", cause, "triangulate it first")
        # Project along the axis closest to the normal, which keeps the polygon counter-clockwise.
        axis = int(np.argmax(np.abs(normals[bad])))
        axes = [(axis + 1) % 3, (axis + 2) % 3][:: -1 if normals[bad, axis] < 0 else 1]
        cut[bad] = polygons[bad][_ears(points[bad][:, axes])]
    return cut


def _cut_quads(points: Float64s, quads: Int32s) -> Int32s:
    one = np.array([[0, 1, 2], [0, 2, 3]])
    other = np.array([[0, 1, 3], [1, 2, 3]])
    diagonals = points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]
    normals = np.cross(*diagonals)
    lengths = [np.einsum("pi,pi->p", diagonal, diagonal) for diagonal in diagonals]
    # Whether both triangles face along the normal and have an area.
    fine = []
    for cut in (one, other):
        triangles = points[:, cut]
        edges = triangles[:, :, 1:] - triangles[:, :, :1]
        areas = np.einsum("pti,pi->pt", np.cross(edges[:, :, 0], edges[:, :, 1]), normals)
        fine.append((areas > 0).all(axis=1))
    take_other = np.where(fine[0] == fine[1], lengths[1] < lengths[0], fine[1])
    return np.where(take_other[:, None, None], quads[:, other], quads[:, one])


def _ears(points: Float64s) -> NDArray[np.intp]:
    """Triangulate a counter-clockwise polygon, shape (n, 2), by ear clipping, shape (n - 2, 3)."""
    # Clipping an ear can change only its two neighbours. So the work is quadratic in n for any polygon.
    left, is_left, triangles, at = [*range(len(points))], np.ones(len(points), bool), [], 0
    axes = np.ascontiguousarray(points.T)
    ears = [_is_ear(axes, left, tip, is_left) for tip in left]
    while len(left) > 3:
        # A self-intersecting polygon may have none.
        tip = next((tip for tip in (*range(at, len(left)), *range(at)) if ears[tip]), at)
        triangles.append((left[tip - 1], left[tip], left[(tip + 1) % len(left)]))
        is_left[left[tip]] = False
        del left[tip], ears[tip]
        at = tip % len(left)  # continue behind the gap to spread the corners
        for neighbour in (at - 1, at):
            ears[neighbour] = _is_ear(axes, left, neighbour, is_left)
    triangles.append((left[at - 1], left[at], left[(at + 1) % 3]))
    return np.array(triangles, np.intp)


def _is_ear(axes: Float64s, left: list[int], tip: int, is_left: Bools) -> bool:
    """Whether a corner and its neighbours form a triangle that faces up and contains no other corner."""
    x, y = axes
    (ax, bx, cx), (ay, by, cy) = axes[:, [left[tip - 1], left[tip], left[(tip + 1) % len(left)]]].tolist()
    if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) <= 0:
        return False
    inside = is_left.copy()
    for sx, sy, ex, ey in ((ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay)):
        inside &= (ex - sx) * (y - sy) - (ey - sy) * (x - sx) >= 0
        inside &= (x != sx) | (y != sy)
    return not inside.any()
