"""The samples of vertex colours.

Vertices that a format splits (for normals, texture coordinates or primitives) become one sample if their positions are
equal up to rounding and their colours are equal. If coincident vertices differ in colour, each colour is a sample, and
bridges join them. On the image manifold (X, beta I) a colour jump along an edge is an upright strip between the two
copies of the edge, with no extent in X and the jump in I. Both diagonals of the strip are added, so that the result
does not depend on the order of vertices. More than two copies of an edge (non-manifold edges) are joined in a chain,
ordered by colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Int32s
from beltrami_cli.surface.geometry import edges_of
from beltrami_cli.surface.grouping import group_equal_rows, group_places
from beltrami_cli.surface.records import ColouredVertices, SampledSurface


@dataclass(frozen=True)
class VertexSampling:
    """The sample of each vertex; ``smoothed[sample_of]`` are vertex colours."""

    sample_of: Int32s  # (V,): coincident vertices of one colour are one sample
    first_vertex: Int32s  # (S,): a vertex of each sample
    # Shape (S,): place of each sample; coincident vertices of different colours are samples of one place.
    place_of: Int32s
    places: int  # number of distinct places, at most S

    def means(self, values: Float32s) -> Float32s:
        """Return the mean over each sample's vertices, shape (V, G) to (S, G)."""
        if len(self.first_vertex) == len(self.sample_of):  # each sample is one vertex
            return values[self.first_vertex]
        samples = len(self.first_vertex)
        count = np.bincount(self.sample_of, minlength=samples)
        sums = [np.bincount(self.sample_of, column, samples) for column in values.T.astype(np.float64)]
        return np.ascontiguousarray((np.array(sums) / count).T, np.float32)

    def surface(self, vertices: ColouredVertices, colours: Float32s) -> SampledSurface:
        """Return the samples as a surface, with colours in the working space, shape (S, N)."""
        if self.places == len(self.sample_of):
            return SampledSurface(vertices.positions, vertices.faces, np.empty((0, 3), np.int32), colours)
        faces = self.sample_of[vertices.faces]
        bridges = build_bridges(faces, self.place_of, colours)
        positions = np.ascontiguousarray(vertices.positions[self.first_vertex])
        return SampledSurface(positions, faces, bridges, colours)


def sample_vertices(vertices: ColouredVertices) -> VertexSampling:
    place_of, first_of_place = group_places(vertices.positions, vertices.space_of, vertices.faces)
    if len(first_of_place) == len(place_of):  # no vertex is split: the vertices are the samples
        every = np.arange(len(place_of), dtype=np.int32)
        return VertexSampling(every, every, every, len(every))
    sample_of, first_vertex = group_equal_rows(place_of, *vertices.colours.T)
    return VertexSampling(sample_of, first_vertex, place_of[first_vertex], len(first_of_place))


def build_bridges(faces: Int32s, place_of: Int32s, colours: Float32s) -> Int32s:
    """Join both sides of hard colour edges between samples by triangles, shape (W, 3)."""
    shared = np.bincount(place_of) > 1
    if not shared.any():
        return np.empty((0, 3), np.int32)
    # Distinct edges of samples that may have copies, their ends ordered by place.
    edges = edges_of(faces)
    edges = edges[shared[place_of[edges]].any(axis=1)]
    places = place_of[edges]
    edges = np.where((places[:, 0] > places[:, 1])[:, None], edges[:, ::-1], edges)
    copies = np.unique(edges[places[:, 0] != places[:, 1]], axis=0)
    if len(copies) < 2:
        return np.empty((0, 3), np.int32)
    places = place_of[copies]
    by_colour = [*colours[copies[:, 1]].T, *colours[copies[:, 0]].T]
    order = np.lexsort([*by_colour, places[:, 1], places[:, 0]])
    copies, places = copies[order], places[order]
    joined = np.all(places[1:] == places[:-1], axis=1)
    # Add both diagonals between the copies (a, b) and (c, d) of an edge.
    (a, b), (c, d) = copies[:-1][joined].T, copies[1:][joined].T
    corners = (a, b, c), (a, b, d), (c, d, a), (c, d, b)
    triangles = np.concatenate([np.stack(three, axis=1) for three in corners])
    # If the copies share an end, two of the four triangles are degenerate, and the others are equal and count once.
    distinct = (triangles[:, 0] != triangles[:, 2]) & (triangles[:, 1] != triangles[:, 2])
    return np.asarray(triangles[distinct], np.int32)
