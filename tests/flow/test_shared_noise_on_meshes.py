"""Noise that neighbouring vertices share, as of baked photographs: found, drawn as it is, and removed."""

from itertools import islice, pairwise

import numpy as np
import pytest

from beltrami_cli import smooth
from beltrami_cli.flow.noise.components import sigma_of_covariances
from beltrami_cli.flow.noise.drawing import draw_on_clusters
from beltrami_cli.flow.vertex_graph import levels_of
from flow.noisy_surfaces import manifold_of, with_grain
from oracles import surfaces
from oracles.pictures import psnr

SIGMA = 12 / 255


@pytest.fixture(scope="module")
def sphere():
    return surfaces.icosphere(5)


def pattern(positions):
    """Return waves, mostly grey as in photographs, far from black and white."""
    grey, tint = (np.sin(k * positions @ np.random.default_rng(k).normal(size=(3, 3))) for k in (4, 2))
    return 0.5 + 0.15 * grey[:, :1] + 0.05 * tint


def test_noise_that_vertices_share_is_found(sphere):
    """To a quarter."""
    positions, faces = sphere
    manifold = manifold_of(positions, faces, with_grain(positions, pattern(positions), SIGMA))
    assert manifold.noise.is_shared
    assert manifold.noise.as_read().of_input == pytest.approx(SIGMA, rel=0.25)
    assert manifold.noise.grain > 1.5


def test_the_channel_with_more_of_the_noise_that_vertices_share_is_known(sphere):
    """To a fifth; by differences of channels alone, red and blue would have the same."""
    positions, faces = sphere
    plain = np.full(positions.shape, 0.5)
    noise = (with_grain(positions, plain, SIGMA) - 0.5) * [1.4, 1.0, 0.6]
    manifold = manifold_of(positions, faces, 0.5 + noise)
    assert manifold.noise.is_shared
    assert manifold.noise.as_read().of_input == pytest.approx(noise.std(axis=0), rel=0.2)


def test_independent_noise_of_vertices_is_not_taken_for_shared_noise(sphere):
    positions, faces = sphere
    clean = pattern(positions)
    noisy = clean + 5 / 255 * np.random.default_rng(2).standard_normal(clean.shape)
    assert not manifold_of(positions, faces, noisy).noise.is_shared


def test_drawn_noise_has_the_details_of_what_was_found(sphere):
    """At single vertices and two levels, to four standard errors of a variance and what it varies in size."""
    positions, faces = sphere
    manifold = manifold_of(positions, faces, with_grain(positions, pattern(positions), SIGMA))
    covariances = manifold.noise.covariances
    levels = list(islice(levels_of(manifold.graph), len(covariances) + 1))
    random = np.random.default_rng(5)
    signs = random.choice(np.float32([-1, 1]), (len(levels), manifold.geometry.size, 3))
    noise = draw_on_clusters(covariances, levels, signs)
    for number, (fine, above) in enumerate(pairwise(levels[:3])):
        parents = above.members[fine.centres]
        details = (fine.means(noise) - above.means(noise)[parents]) * np.sqrt(fine.counts)[:, None]
        power = np.square(details).sum(axis=0) / (1 - fine.counts / above.counts[parents]).sum()
        tolerance = 4 * np.sqrt(2 / (fine.graph.size - above.graph.size))
        assert power == pytest.approx(np.diag(covariances[number]), rel=tolerance)
    assert noise.std(axis=0) == pytest.approx(sigma_of_covariances(covariances), rel=0.1)


@pytest.mark.slow
def test_noise_that_vertices_share_is_removed_and_no_psnr_is_predicted(sphere):
    positions, faces = sphere
    clean = pattern(positions)
    noisy = with_grain(positions, clean, SIGMA)
    result = smooth(positions, faces, noisy)
    assert psnr(result.colours, clean) > psnr(noisy, clean) + 5
    assert result.choice.correlated
    assert result.choice.predicted is None


@pytest.mark.slow
def test_black_stays_black_where_vertices_share_noise(sphere):
    """To a fifth of the 0.4 standard deviations by which noise that is cut off at 0 makes it brighter."""
    positions, faces = sphere
    clean = np.where(positions[:, 2:] > 0, pattern(positions), 0)
    result = smooth(positions, faces, with_grain(positions, clean, SIGMA))
    assert result.colours[positions[:, 2] < -0.2].mean() < 0.4 * SIGMA / 5
