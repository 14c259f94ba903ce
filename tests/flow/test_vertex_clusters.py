"""Clusters of vertices: what they are, whatever the order of the vertices, and what their means are good for."""

import pickle

import numpy as np
import pytest

from beltrami_cli.flow.manifolds.mesh.levels import clusters_for
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.vertex_graph import Graph
from flow.noisy_surfaces import manifold_of
from oracles import surfaces

RANDOM = np.random.default_rng(11)


def graph_of(positions, faces, priorities):
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return Graph(positions, np.unique(pairs, axis=0).astype(np.int32), priorities)


@pytest.fixture(scope="module")
def sphere():
    positions, faces = surfaces.icosphere(4)
    priorities = RANDOM.integers(0, 2**63, len(positions), dtype=np.uint64)
    # Samples without edges are clusters of their own.
    positions = np.vstack([positions, [[5, 5, 5], [6, 6, 6]]])
    return graph_of(positions, faces, np.r_[priorities, np.uint64(1), np.uint64(1)])


def test_clusters_are_samples_and_neighbours_of_theirs(sphere):
    members, centres = sphere.clusters()
    neighbours = {(a, b) for pair in sphere.edges.tolist() for a, b in (pair, pair[::-1])}
    assert np.array_equal(members[centres], np.arange(len(centres)))
    for sample, centre in enumerate(centres[members].tolist()):
        assert sample == centre or (sample, centre) in neighbours
    chosen = set(centres.tolist())
    assert not any(a in chosen and b in chosen for a, b in neighbours)
    # On a triangle lattice a centre has six neighbours, and no two are adjacent: a third to a seventh are centres.
    assert 1 / 7 < len(centres) / sphere.size < 1 / 3


def test_clusters_are_joined_where_their_samples_are(sphere):
    members, centres = sphere.clusters()
    found = sphere.clustered(members, centres)
    wanted = {(min(a, b), max(a, b)) for a, b in members[sphere.edges].tolist() if a != b}
    assert {tuple(pair) for pair in found.edges.tolist()} == wanted
    mean = sphere.positions[members == members[0]].mean(axis=0)
    np.testing.assert_allclose(found.positions[members[0]], mean)


def test_a_change_of_all_clusters_is_that_of_all_samples(sphere):
    stack = RANDOM.random((sphere.size, 3)).astype(np.float32)
    whole = stack.sum(axis=0, dtype=np.float64)
    levels = clusters_for(sphere, 2, None)
    assert levels
    for level in levels:
        means = level.means(stack)
        assert len(means) < sphere.size / 3
        # The mean over clusters, each by its samples, is that over samples.
        np.testing.assert_allclose(level.total(np.ascontiguousarray(means.T)), whole, rtol=1e-5)
        changed = stack.copy()
        level.add_enlarged_in_place(changed, np.full_like(means, 0.25))
        np.testing.assert_allclose(changed, stack + 0.25, atol=1e-5)


def test_parts_do_not_carry_the_graph_of_the_whole():
    positions, faces = surfaces.icosphere(5)
    colours = RANDOM.random((len(positions), 3))
    manifold = manifold_of(positions, faces, colours, KernelParameters(iterations=1))
    part = np.arange(50)
    before = len(pickle.dumps(manifold.cut(part)))
    manifold.perturbation()
    assert len(pickle.dumps(manifold.cut(part))) < 1.1 * before + 1000
