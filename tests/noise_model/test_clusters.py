"""Clusters of vertices as neighbourhoods of the noise model, and the noise that is read of them."""

import numpy as np
import pytest

from beltrami_cli.flow.noise.clusters import VertexClusters
from beltrami_cli.flow.noise.components import SCALES
from beltrami_cli.flow.noise.features import Features
from beltrami_cli.flow.noise.reading import read_noise
from beltrami_cli.flow.vertex_graph import Graph
from observations import covariance_of
from oracles import surfaces

WHITE = 0.04


def lattice(rows, columns, seed=0):
    """Return the graph of a triangle lattice."""
    positions, faces = surfaces.lattice(rows, columns)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    priorities = np.random.default_rng(seed).integers(0, 2**63, rows * columns, dtype=np.uint64)
    return Graph(positions, edges.astype(np.int32), priorities)


def white(size, seed=0):
    return (0.5 + WHITE * np.random.default_rng(seed).standard_normal((3, size))).astype(np.float32)


def painted(graph):
    """Return a slope and edges, shape (3, S)."""
    away = graph.positions - graph.positions.min(axis=0)
    x, y = away[:, :2].T / away.max()
    return np.stack([0.3 + 0.4 * x, 0.7 - 0.4 * y, np.where(x + y > 0.9, 0.6, 0.4)])


def read(graph, colours):
    stored = np.rint(colours.clip(0, 1) * 255).astype(np.float32) / 255
    return read_noise(stored, VertexClusters.of(graph))


def test_independent_noise_has_the_same_variance_at_all_scales():
    clusters = VertexClusters.of(lattice(160, 120))
    cells = clusters.cut(white(clusters.graph.size)).cells
    assert len(cells) == SCALES
    for own in cells:
        count = float(own.freedom.sum())  # of three components each; four standard errors of a variance
        variance = np.trace(covariance_of(own)) / 3 / 255**2
        assert variance == pytest.approx(WHITE**2, rel=4 * np.sqrt(2 / (3 * count)))


def test_the_order_of_vertices_does_not_matter():
    graph = lattice(60, 50)
    colours, order = white(graph.size), np.random.default_rng(1).permutation(graph.size)
    rank = np.argsort(order).astype(np.int32)
    other = Graph(graph.positions[order], rank[graph.edges], graph.priorities[order])
    found = []
    for own, values in ((graph, colours), (other, colours[:, order])):
        described = Features.of(VertexClusters.of(own).cut(values)).local
        found.append(described[np.lexsort(described.T[:3])])
    np.testing.assert_allclose(*found, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("rows", [17, 25])
def test_small_surfaces_have_finite_features(rows):
    clusters = VertexClusters.of(lattice(rows, rows))
    features = Features.of(clusters.cut(white(rows**2)))
    assert len(features.local) == clusters.count
    for own in (features.local, features.quiet, features.even, features.even_deviations):
        assert np.isfinite(own).all()


@pytest.mark.parametrize("size", [0, 3, 100])
def test_vertices_without_edges_are_no_neighbourhoods(size):
    rng = np.random.default_rng(0)
    priorities = rng.integers(0, 2**63, size, dtype=np.uint64)
    graph = Graph(rng.random((size, 3)), np.zeros((0, 2), np.int32), priorities)
    assert VertexClusters.of(graph).count == 0


@pytest.mark.slow
def test_large_surfaces_are_read_in_some_blocks():
    clusters = VertexClusters.of(lattice(400, 300))
    assert 2**15 < len(clusters.chosen) <= 2**16
    share = len(clusters.chosen) / clusters.graph.size
    counts = np.histogram(clusters.chosen, bins=8, range=(0, clusters.graph.size))[0]
    np.testing.assert_allclose(counts / clusters.graph.size * 8, share, rtol=0.3)


@pytest.mark.parametrize("sigma", [3, 8, 20])
@pytest.mark.parametrize("channels", [1, 3], ids=["shared by channels", "independent"])
def test_noise_of_vertices_is_read(sigma, channels):
    graph = lattice(70, 70)
    noise = sigma / 255 * np.random.default_rng(sigma).standard_normal((channels, graph.size))
    model = read(graph, painted(graph) + noise)
    assert model.overall == pytest.approx(sigma / 255, rel=0.3)
    correlations = model.covariance / np.outer(model.sigma, model.sigma)
    assert (correlations[0, 1] > 0.5) == (channels == 1)


@pytest.mark.parametrize("colours", [np.zeros, np.ones, "painted"], ids=["black", "white", "painted"])
def test_vertices_without_noise_have_none(colours):
    graph = lattice(70, 70)
    clean = painted(graph) if colours == "painted" else colours((3, graph.size))
    assert not read(graph, clean).covariances.any()
