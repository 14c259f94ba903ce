"""Fast marching on a triangulated manifold in any dimension, and a kernel: slow, plain, in double precision.

Follows R. Kimmel, J. A. Sethian, "Computing geodesic paths on manifolds", PNAS 95 (1998): an upwind update
from two known corners of a triangle, with obtuse corners split by unfolding neighbouring triangles. Only edge
lengths enter, so that the dimension of the embedding does not matter.

A stencil is a corner C with two supports A and B: either an acute corner of a face, or one half of an obtuse
corner, whose second support is the vertex found by unfolding. An obtuse corner that cannot be split leaves
the two edges that meet in it. Rules for what is not a manifold:

- faces with the same three corners are one face; a face that repeats a corner contributes its edges only;
- unfolding stops at an edge that does not have exactly two faces, and at an edge of length zero;
- a corner on an edge of length zero, or opposite one, has no angle and leaves its edges.

The kernel follows A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images and manifolds",
IEEE Transactions on Image Processing 16 (2007), equations (8) and (9). Exact distances in space are by pygeodesic
(Mitchell, Mount, Papadimitriou 1987).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from itertools import combinations
from math import inf, log, sqrt

import numpy as np
from pygeodesic import geodesic
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

# A corner counts as obtuse only if its cosine is below this. Right angles of a grid must not be split or left
# whole by the last bit of a square root; both ways are correct there, but they differ in value.
OBTUSE = -1e-9

# Faces unfolded for one corner before it is given up.
UNFOLDING_STEPS = 64


@dataclass
class Manifold:
    """Stencils of a triangulated manifold, made once for marching from many sources.

    `edges`: for each vertex, the vertices that it can reach in a straight line, and how far they are: over edges of
    faces, and to the supports of split corners. `stencils`: for each vertex S, the stencils that S supports:
    (C, other support) to (|CS|, |C other|, cosine at C).
    """

    embedding: np.ndarray
    faces: np.ndarray
    edges: list = field(init=False)
    stencils: list = field(init=False)

    def __post_init__(self):
        self.embedding = np.asarray(self.embedding, dtype=np.float64)
        self.faces = np.asarray(self.faces, dtype=np.int64).reshape(-1, 3)
        count = len(self.embedding)
        self.edges = [{} for _ in range(count)]
        self.stencils = [{} for _ in range(count)]
        self.facing = {}  # edge (low, high) -> third corners of the faces that hold it
        triangles = sorted({tuple(sorted(face)) for face in self.faces.tolist()})
        for triangle in triangles:
            for a, b in combinations(triangle, 2):
                if a != b:
                    self.join(a, b, self.length(a, b))
        triangles = [triangle for triangle in triangles if len(set(triangle)) == 3]
        for a, b, c in triangles:
            for p, q, r in ((a, b, c), (b, c, a), (a, c, b)):
                self.facing.setdefault((min(p, q), max(p, q)), []).append(r)
        for a, b, c in triangles:
            for p, q, r in ((a, b, c), (b, c, a), (c, a, b)):
                self.add_corner(p, q, r)

    def length(self, i, j):
        return float(np.linalg.norm(self.embedding[i] - self.embedding[j]))

    def join(self, i, j, length):
        """Let two vertices reach each other in a straight line."""
        self.edges[i][j] = min(length, self.edges[i].get(j, inf))
        self.edges[j][i] = min(length, self.edges[j].get(i, inf))

    def add_corner(self, a, b, c):
        """Add the stencils of the corner at `c` of the face (a, b, c)."""
        to_a, to_b, across = self.length(c, a), self.length(c, b), self.length(a, b)
        if to_a == 0 or to_b == 0 or across == 0:
            return
        cosine = (to_a**2 + to_b**2 - across**2) / (2 * to_a * to_b)
        if cosine >= OBTUSE:
            self.add_stencil(c, a, b, to_a, to_b, min(cosine, 1.0))
        elif (support := self.unfolded(a, b, c, max(cosine, -1.0))) is not None:
            d, x, y, b_x, b_y = support
            to_d = sqrt(x * x + y * y)
            self.join_one_way(d, c, to_d)
            self.add_stencil(c, a, d, to_a, to_d, x / to_d)
            self.add_stencil(c, d, b, to_d, to_b, (x * b_x + y * b_y) / (to_d * to_b))

    def join_one_way(self, i, j, length):
        """Let vertex `i` reach vertex `j`."""
        self.edges[i][j] = min(length, self.edges[i].get(j, inf))

    def add_stencil(self, c, a, b, to_a, to_b, cosine):
        """Let `a` and `b` together update `c`."""
        self.stencils[a].setdefault((c, b), []).append((to_a, to_b, cosine))
        self.stencils[b].setdefault((c, a), []).append((to_b, to_a, cosine))

    def unfolded(self, a, b, c, cosine):
        """Return the vertex that splits the obtuse corner at `c`, its place in the plane of the face, and that of `b`.

        The plane has its origin at `c` and `a` on its first axis. Faces are unfolded over the edge (p, q), at first
        (a, b), where p stays on the side of `a` of the section in which both halves are acute, and q on that of `b`.
        """
        to_a, to_b = self.length(c, a), self.length(c, b)
        place_a = np.array([to_a, 0.0])
        place_b = to_b * np.array([cosine, sqrt(1 - cosine * cosine)])
        p, q, place_p, place_q, last = a, b, place_a, place_b, c
        for _ in range(UNFOLDING_STEPS):
            facing = self.facing[min(p, q), max(p, q)]
            if len(facing) != 2 or self.length(p, q) == 0:
                return None
            d = facing[0] if facing[1] == last else facing[1]
            place_d = self.place_beyond(p, q, d, place_p, place_q)
            if place_d @ place_a <= 0:
                q, place_q, last = d, place_d, q
            elif place_d @ place_b <= 0:
                p, place_p, last = d, place_d, p
            else:
                return None if d in (a, b, c) else (d, *place_d, *place_b)
        return None

    def place_beyond(self, p, q, d, place_p, place_q):
        """Return where `d` lies on the far side of the edge (p, q) from the origin."""
        across, to_p, to_q = self.length(p, q), self.length(p, d), self.length(q, d)
        along = (to_p**2 + across**2 - to_q**2) / (2 * across)
        height = sqrt(max(to_p**2 - along**2, 0.0))
        direction = (place_q - place_p) / across
        normal = np.array([direction[1], -direction[0]])
        if normal @ place_p < 0:
            normal = -normal
        return place_p + along * direction + height * normal

    def distances(self, source, stop=inf):
        """Return the geodesic distances from one vertex, infinite beyond `stop` and where nothing leads."""
        phi = np.full(len(self.embedding), inf)
        accepted = np.zeros(len(phi), bool)
        phi[source] = 0.0
        heap = [(0.0, source)]
        while heap:
            value, here = heapq.heappop(heap)
            if accepted[here]:
                continue
            if value > stop:
                break
            accepted[here] = True
            for there, update in self.updates(here, phi, accepted):
                if not accepted[there] and update < phi[there]:
                    phi[there] = update
                    heapq.heappush(heap, (update, there))
        return np.where(accepted, phi, inf)

    def updates(self, here, phi, accepted):
        """Yield the vertices that a newly accepted one can update, and the values that it gives them."""
        for there, length in self.edges[here].items():
            yield there, phi[here] + length
        for (there, other), corners in self.stencils[here].items():
            if accepted[other]:
                for to_here, to_other, cosine in corners:
                    first, second = (phi[here], to_here), (phi[other], to_other)
                    yield there, triangle_update(*min(first, second), *max(first, second), cosine)


def triangle_update(phi_a, b, phi_b, a, cosine):
    """Return the value at C by the front that passes A and then B, or infinity if none runs through the triangle.

    Solves (a^2 + b^2 - 2 a b cos) s^2 + 2 b u (a cos - b) s + b^2 (u^2 - a^2 sin^2) = 0, where a = |CB|,
    b = |CA| and u = phi(B) - phi(A) >= 0, for the larger root.
    """
    u = phi_b - phi_a
    square = a * a + b * b - 2 * a * b * cosine
    half = b * u * (a * cosine - b)
    rest = b * b * (u * u - a * a * (1 - cosine * cosine))
    discriminant = half * half - square * rest
    if square <= 0 or discriminant < 0:
        return inf
    s = (-half + sqrt(discriminant)) / square
    inside = u < s and a * cosine * s < b * (s - u) and b * (s - u) * cosine < a * s
    return phi_a + s if inside else inf


def embed(positions, colours, beta):
    """Return the image manifold (X, beta I), shape (V, M + N)."""
    return np.hstack([np.asarray(positions, float), beta * np.asarray(colours, float)])


def short_time_kernel(embedding, faces, colours, t, threshold=0.01, weights=None):
    """Return the colours after one Jacobi iteration on an image manifold; `t` is in squared units of it."""
    colours = np.asarray(colours, float)
    weights = np.ones(len(colours)) if weights is None else np.asarray(weights, float)
    manifold = Manifold(embedding, faces)
    reach = sqrt(-4 * t * log(threshold))
    smoothed = np.empty_like(colours)
    for p in range(len(colours)):
        d = manifold.distances(p, stop=reach)
        kernel = np.where(np.isfinite(d), weights * np.exp(-(np.minimum(d, 1e6 * reach) ** 2) / (4 * t)), 0.0)
        # A sample whose whole neighbourhood counts nothing keeps its colour.
        smoothed[p] = kernel @ colours / kernel.sum() if kernel.sum() > 0 else colours[p]
    return smoothed


def exact_distances(positions, faces, source):
    """Return the lengths of the shortest paths over a manifold in space without isolated vertices."""
    points = np.ascontiguousarray(positions, dtype=np.float64)
    solver = geodesic.PyGeodesicAlgorithmExact(points, np.ascontiguousarray(faces, dtype=np.int32))
    found, _ = solver.geodesicDistances(np.array([source], dtype=np.int32), None)
    return np.asarray(found)


def graph_distances(embedded, faces, extra):
    """Return the shortest paths between vertices through some extra points on every edge of every face."""
    points, links, number = list(embedded), [], {}

    def on_edge(a, b):
        a, b = min(a, b), max(a, b)
        if (a, b) not in number:
            steps = np.arange(1, extra + 1) / (extra + 1)
            number[a, b] = range(len(points), len(points) + extra)
            points.extend(embedded[a] + s * (embedded[b] - embedded[a]) for s in steps)
        return [a, *number[a, b], b]

    for a, b, c in np.asarray(faces).tolist():
        rim = sorted({*on_edge(a, b), *on_edge(b, c), *on_edge(a, c)})
        links += [(p, q) for p in rim for q in rim if p < q]
    count = len(embedded)
    if not links:
        return np.where(np.eye(count, dtype=bool), 0, np.inf)
    places, ends = np.array(points), np.array(sorted(set(links)), np.int32)
    # A graph takes a weight of 0 for no link.
    lengths = np.maximum(np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1), 1e-12)
    graph = coo_array((lengths, ends.T), shape=(len(points),) * 2).tocsr()
    return dijkstra(graph, directed=False, indices=range(count))[:, :count]
