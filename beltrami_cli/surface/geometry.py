"""Areas, normals, edges, boundary and counts of triangle meshes.

References
----------
.. [1] G. Thuermer, C. Wuethrich, "Computing vertex normals from polygonal facets", Journal of Graphics Tools 3(1),
   1998, doi:10.1080/10867651.1998.10487487: triangles weighted by their angle at the vertex, so that it does not matter
   how a face is cut.
.. [2] M. Garland, P. Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997,
   doi:10.1145/258734.258849
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.grouping import group_equal_rows


def bounds(positions: Float64s) -> list[list[float]]:
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


def scaled_to_unit(positions: Float64s) -> Float64s:
    """Centre and scale points so that the furthest is at 1/2 to 1, and squares neither underflow nor overflow."""
    if not len(positions):
        return positions
    # Halves, since a sum may overflow; a power of two, since it does not round.
    points = positions / 2 - (positions.min(axis=0) / 2 + positions.max(axis=0) / 2) / 2
    extent = float(np.abs(points).max())
    return np.asarray(np.ldexp(points, -int(np.frexp(extent)[1]))) if extent > 0 else points


def triangle_areas(positions: Float64s, faces: Int32s) -> Float64s:
    """Compute the areas of triangles in any dimension from the Gram determinant."""
    p = positions[faces[:, 1]] - positions[faces[:, 0]]
    q = positions[faces[:, 2]] - positions[faces[:, 0]]
    gram = (p * p).sum(1) * (q * q).sum(1) - (p * q).sum(1) ** 2
    return np.asarray(0.5 * np.sqrt(np.maximum(gram, 0)))


def cross_in_plane(a: Float64s, b: Float64s) -> Float64s:
    """Return the cross products of vectors in a plane, shape (K, 2)."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


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


# Number of averages over neighbours: enough to be steady where edge lengths vary at random, few enough to follow a
# gradation of the mesh.
_SMOOTHING_ROUNDS = 3


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


def edges_of(faces: Int32s) -> Int32s:
    """Return the edges of triangles, (3 F, 2): all first edges, then the second and the third."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def without_unused(positions: Float64s, faces: Int32s) -> tuple[Float64s, Int32s]:
    """Return the vertices that faces use, and the renumbered faces."""
    used = np.zeros(len(positions), bool)
    used[faces] = True
    return positions[used], (np.cumsum(used, dtype=np.int32) - 1)[faces]
