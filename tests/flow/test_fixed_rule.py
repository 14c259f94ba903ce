"""The fixed rule of --fast: what is not given, it sets by the noise, and it is not far from what is chosen."""

from __future__ import annotations

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.parameters import TUNABLE
from beltrami_cli.flow.search_range import RULE_ON_GRIDS, RULE_ON_MESHES
from oracles import surfaces


def painting(size=96):
    """Return an image of a disc on a slope, stripes and a slope, in [0.25, 0.75], so that noise is hardly cut off."""
    y, x = np.mgrid[:size, :size] / size
    disc = (x - 0.45) ** 2 + (y - 0.5) ** 2 < 0.08
    stripes = (x + y) % 0.4 < 0.2
    return np.stack([np.where(disc, 0.7, 0.35 + 0.1 * x), np.where(stripes, 0.3, 0.6), 0.3 + 0.4 * y], axis=2)


def noisy(clean, sigma=20 / 255):
    return (clean + sigma * np.random.default_rng(5).standard_normal(clean.shape)).astype(np.float32)


def psnr(result, clean):
    return -10 * np.log10(np.mean((np.asarray(result, float) - clean) ** 2))


def test_a_fixed_rule_sets_what_is_not_given_when_time_counts():
    image = noisy(painting(48))
    fast = beltrami_cli.smooth_image(image, space="data", fast=True)
    assert set(fast.choice.chosen) == set(TUNABLE)
    assert fast.choice.candidates == 0
    reported = beltrami_cli.smooth_image(image, space="data", **fast.choice.chosen)
    assert np.array_equal(fast.colours, reported.colours)
    partly = beltrami_cli.smooth_image(image, space="data", iterations=2, fast=True)
    assert partly.choice.chosen == {
        name: value for name, value in fast.choice.chosen.items() if name != "iterations"
    }


def test_the_fixed_rule_smooths_further_where_there_is_more_noise():
    for rule in (RULE_ON_GRIDS, RULE_ON_MESHES):
        counts = [rule.count(noise / 255) for noise in (0, 1, 5, 10, 20, 40, 200)]
        assert counts == sorted(counts)
        assert counts[0] == counts[2] == rule.iterations
        assert counts[3] == rule.iterations + rule.more
        assert counts[-1] == rule.max_iterations


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.02, 0.08])
def test_the_fixed_rule_is_not_far_from_the_choice(sigma):
    """On flat paint, where it loses most (3.7 dB at worst on textures), for it must not lose the detail of others."""
    clean = painting()
    image = noisy(clean, sigma)
    positions, faces = surfaces.icosphere(4)
    on_ball = 0.5 + 0.2 * np.sign(np.sin(5 * positions))
    colours = noisy(on_ball, sigma)
    flat = [beltrami_cli.smooth_image(image, space="data", fast=fast) for fast in (True, False)]
    round_ = [
        beltrami_cli.smooth(positions, faces, colours, space="data", fast=fast) for fast in (True, False)
    ]
    for (fast, slow), true in ((flat, clean), (round_, on_ball)):
        assert psnr(fast.colours, true) > psnr(slow.colours, true) - 4
