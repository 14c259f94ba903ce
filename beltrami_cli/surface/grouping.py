"""Equal rows found by hashing: what is at one place, and vertex colours as samples.

Vertices that a format splits (for normals, texture coordinates, primitives) but that stand at exactly one place with
one colour become one sample. Where coincident vertices differ in colour, each colour is a sample of its own, and
bridges join them: on the image manifold (X, beta I) a colour jump along an edge is an upright strip between the edge's
two copies, with no extent in X and the jump in I. Both of its diagonals are laid, so that the result does not depend on
the order of vertices. More than two copies of one edge (non-manifold edges) are joined in a chain, by the order of
their colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s
from beltrami_cli.surface.records import PaintedVertices, SampledSurface

# Odd constants of the splitmix64 generator (Steele, Lea, Flood 2014): each step is a bijection of 64-bit words.
_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def group_equal_rows(*columns: Array) -> tuple[Int32s, Int32s]:
    """Find the distinct rows of a table, numbered by their first row: each row's number, and first rows."""
    # Columns are of any integer or floating type, without NaN; -0.0 equals 0.0.
    words = [_as_words(column) for column in columns]
    hashed = np.zeros(len(words[0]), np.uint64)
    for word in words:
        hashed = mix_bits(hashed ^ word)
    ascending = np.sort(hashed)
    if not np.any(ascending[1:] == ascending[:-1]):  # as in most files; to sort alone is quick
        every = np.arange(len(hashed), dtype=np.int32)
        return every, every.copy()
    order = np.argsort(hashed, kind="stable")
    new, same_hash = _run_starts(words, order), hashed[order][1:] == hashed[order][:-1]
    if np.any(new[1:] & same_hash):  # two different rows with one hash: sort by the rows themselves
        order = np.lexsort(words)
        new = _run_starts(words, order)
    # The sort is stable, so the first member of a run is the group's first row.
    first_of_run = order[new]
    by_first = np.argsort(first_of_run)
    rank = np.empty(len(by_first), np.int32)
    rank[by_first] = np.arange(len(by_first), dtype=np.int32)
    group_of = np.empty(len(order), np.int32)
    group_of[order] = rank[np.cumsum(new) - 1]
    return group_of, first_of_run[by_first].astype(np.int32)


def _run_starts(columns: Sequence[Array], order: NDArray[np.intp]) -> Bools:
    """Return which rows of a table differ from the one before them in an order."""
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in columns:
        new[1:] |= column[order][1:] != column[order][:-1]
    return new


def group_places(positions: Float64s, space_of: Int32s | None) -> tuple[Int32s, Int32s]:
    """Find the distinct positions, each in its space, as `group_equal_rows` does."""
    return group_equal_rows(*positions.T, *([] if space_of is None else [space_of]))


def _as_words(column: Array) -> NDArray[np.uint64]:
    if column.dtype.kind == "f":
        return (column.astype(np.float64) + 0.0).view(np.uint64)
    return column.astype(np.int64).view(np.uint64)


def mix_bits(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Scatter the bits of words, each to another word."""
    word = word + _INCREMENT
    word = (word ^ (word >> np.uint64(30))) * _MIX_1
    word = (word ^ (word >> np.uint64(27))) * _MIX_2
    return word ^ (word >> np.uint64(31))


@dataclass(frozen=True)
class VertexSampling:
    """Which sample each vertex is; ``smoothed[sample_of]`` are vertex colours."""

    sample_of: Int32s  # (V,): sample of each vertex. Vertices at one place with one colour are one sample.
    first_vertex: Int32s  # (S,): A vertex of each sample
    # Shape (S,): place of each sample; coincident vertices that differ in colour are samples of one place.
    place_of: Int32s
    places: int  # distinct places, at most S

    def means(self, values: Float32s) -> Float32s:
        """Give each sample the mean of what its vertices have, shape (V, G) to (S, G)."""
        if len(self.first_vertex) == len(self.sample_of):  # each sample is one vertex
            return values[self.first_vertex]
        samples = len(self.first_vertex)
        count = np.bincount(self.sample_of, minlength=samples)
        sums = [np.bincount(self.sample_of, column, samples) for column in values.T.astype(np.float64)]
        return np.ascontiguousarray((np.array(sums) / count).T, np.float32)


def sample_vertices(painted: PaintedVertices, colours: Float32s) -> tuple[SampledSurface, VertexSampling]:
    """Make samples of painted vertices whose colours in the working space are given."""
    place_of, first_of_place = group_places(painted.positions, painted.space_of)
    if len(first_of_place) == len(place_of):  # nothing is split: the vertices are the samples
        every = np.arange(len(place_of), dtype=np.int32)
        no_bridges = np.empty((0, 3), np.int32)
        surface = SampledSurface(painted.positions, painted.faces, no_bridges, np.ascontiguousarray(colours))
        return surface, VertexSampling(every, every, every, len(every))
    sample_of, first_vertex = group_equal_rows(place_of, *painted.colours.T)
    faces = sample_of[painted.faces]
    sample_colours = np.ascontiguousarray(colours[first_vertex])
    bridges = build_bridges(faces, place_of[first_vertex], sample_colours)
    positions = np.ascontiguousarray(painted.positions[first_vertex])
    surface = SampledSurface(positions, faces, bridges, sample_colours)
    return surface, VertexSampling(sample_of, first_vertex, place_of[first_vertex], len(first_of_place))


def build_bridges(faces: Int32s, place_of: Int32s, colours: Float32s) -> Int32s:
    """Join the two sides of hard colour edges between samples by triangles, shape (W, 3)."""
    shared = np.bincount(place_of) > 1
    if not shared.any():
        return np.empty((0, 3), np.int32)
    # Distinct edges of samples that may have a copy, both ends in order of place.
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
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
    return _wall_triangles(copies[:-1][joined], copies[1:][joined])


def _wall_triangles(one: Int32s, other: Int32s) -> Int32s:
    """Make the triangles between copies one = (a, b) and other = (c, d) of edges, both diagonals laid."""
    a, b, c, d = one[:, 0], one[:, 1], other[:, 0], other[:, 1]
    corners = (a, b, c), (a, b, d), (c, d, a), (c, d, b)
    triangles = np.concatenate([np.stack(three, axis=1) for three in corners])
    # Where the copies share an end, two of the four repeat a corner; the others are equal and count once.
    distinct = (triangles[:, 0] != triangles[:, 2]) & (triangles[:, 1] != triangles[:, 2])
    return np.asarray(triangles[distinct], np.int32)
