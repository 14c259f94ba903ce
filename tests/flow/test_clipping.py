"""Averages of noise that was cut off at 0 and full scale come out right, and nothing else changes."""

from functools import partial

import numpy as np
import pytest
from scipy import stats

from beltrami_cli import smooth, smooth_image
from beltrami_cli.flow.corrections.clipping import ClippedChannel, ClippedChannels, find_clipped
from beltrami_cli.flow.corrections.normal_tables import variance_of_clipped
from oracles import surfaces

SIGMA = 0.08

# Given, so that they are not chosen from the data.
FIXED = {
    "iterations": 5, "t": 2.4, "beta": 0.8 / SIGMA, "beta_growth": 2.0, "metric_steps": 2, "metric_scale": 0.5,
}  # fmt: skip


def flat(level, size=64, seed=3):
    """Return a grey image of one level with noise, cut off at 0 and 1."""
    noise = SIGMA * np.random.default_rng(seed).standard_normal((size, size, 1))
    return np.clip(level + noise, 0, 1).astype(np.float32)


@pytest.mark.parametrize("level", [0.0, 0.03, 0.97, 1.0])
@pytest.mark.parametrize("on", ["image", "mesh"])
def test_the_mean_of_clipped_noise_is_restored(level, on):
    image = flat(level)
    smoothed = partial(smooth_image, image)
    if on == "mesh":
        smoothed = partial(smooth, *surfaces.plane(*image.shape[:2]), image.reshape(-1, 1))
    kept, restored = (smoothed(**FIXED, clipping=way).colours for way in ("keep", "restore"))
    bias_kept, bias = abs(kept.mean() - level), abs(restored.mean() - level)
    # The bias at the limit is sigma phi(0) = 0.4 sigma, and 0.26 sigma at a distance of 0.3 sigma (Tobin 1958). The
    # rest comes from the scatter of shares of few samples, and from noise that is estimated too low in such an image.
    assert bias_kept > 0.15 * SIGMA
    assert bias < 0.4 * bias_kept


def test_the_true_value_follows_from_mean_and_share_of_a_censored_normal():
    draws = np.random.default_rng(0).standard_normal((400_000, 1))
    for level in (0.0, 0.03, 0.1, 0.9, 0.95, 1.0):
        samples = np.clip(level + SIGMA * draws, 0, 1).astype(np.float32)
        clipped = find_clipped(samples.T, np.array([SIGMA]))
        mean = samples.mean(axis=0, keepdims=True, dtype=np.float64).T.astype(np.float32)
        marks = clipped.marks_of(samples.T).mean(axis=1, keepdims=True, dtype=np.float64).astype(np.float32)
        clipped.restore_in_place(mean, marks, np.float32(1))
        # The mean of 400,000 draws has a standard error of 0.002 sigma; near the limit it is up to tripled.
        assert abs(mean[0, 0] - level) < 0.01 * SIGMA


@pytest.mark.parametrize("in_rows", [False, True])
def test_what_was_cut_off_follows_the_formulas_in_any_layout_on_any_number_of_threads(in_rows):
    random = np.random.default_rng(4)
    found = ClippedChannels((ClippedChannel(0.1, True, True), ClippedChannel(0.05, False, True)))
    shape = (20_000, 2) if in_rows else (2, 20_000)
    noisy, means, estimate, share = random.uniform(-0.2, 1.2, (4, *shape)).astype(np.float32).clip(0, 1)
    relative = random.uniform(0.3, 3, 20_000).astype(np.float32)
    share *= np.sign(random.uniform(-1, 1, shape)).astype(np.float32) / 2
    channels = [part.T if in_rows else part for part in (noisy, means, estimate, share)]
    results = []
    for threads in (1, 3):
        own, restored = channels[0].copy(order="K"), channels[1].copy(order="K")
        found.impute_in_place(own, channels[2], relative, threads)
        found.restore_in_place(restored, channels[3], relative, threads)
        results.append((found.marks_of(channels[0]), own, restored))
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)
    for k, (marks, imputed, restored) in enumerate(zip(*results[0], strict=True)):
        colour, mean, around, part = (own[k].astype(float) for own in channels)
        sigma = found.channels[k].sigma * np.sqrt(relative)
        high, low = colour >= 1, (colour <= 0) & found.channels[k].low
        np.testing.assert_array_equal(marks, high * 1.0 - low)
        side = np.where(high, 1, -1)
        alpha = np.minimum(np.where(high, 1 - around, around) / sigma, 8)  # where the table ends
        expected = around + side * sigma * stats.norm.pdf(alpha) / stats.norm.sf(alpha)
        # The table is linear between limits 16 / 4096 apart.
        np.testing.assert_allclose(imputed, np.where(high | low, expected, colour), atol=1e-5)
        alpha = stats.norm.isf(np.abs(part).clip(1e-12))
        gap = alpha * stats.norm.cdf(alpha) + stats.norm.pdf(alpha)
        from_limit = np.where(part > 0, 1 - mean, mean)
        moved = np.sign(part) * np.minimum(from_limit / gap, 1.2 * sigma) * (gap - alpha).clip(0)
        within = np.abs(part) > 0.01  # below, the table is coarse
        np.testing.assert_allclose(restored[within], (mean + moved).clip(0, 1)[within], atol=2e-4)


def test_one_row_is_restored_as_it_is_among_others():
    """As of the last block of rows; NumPy sets steps along an axis of one sample to anything."""
    random = np.random.default_rng(5)
    colours = random.uniform(0, 0.1, (1, 7, 40)).astype(np.float32)
    marks = random.random((1, 7, 40), np.float32)
    relative = random.uniform(0.5, 2, (7, 40)).astype(np.float32)
    clipped = ClippedChannels((ClippedChannel(0.05, True, False),))
    whole, row = colours.copy(), colours[:, 6:].copy()
    clipped.restore_in_place(whole, marks, relative)
    clipped.restore_in_place(row, marks[:, 6:], relative[6:])
    assert np.array_equal(row, whole[:, 6:])


@pytest.mark.parametrize("kind", ["far from the limits", "without noise", "linear"])
def test_what_was_not_cut_off_is_not_moved(kind):
    clean = np.zeros((32, 32, 1), np.float32)
    clean[8:20, 8:20] = 1
    image, parameters = {
        "far from the limits": (flat(0.5), FIXED),
        "without noise": (clean, {"beta": 5.0}),
        "linear": (flat(1.0), {"beta": 0}),
    }[kind]
    kept, restored = (smooth_image(image, **parameters, clipping=way).colours for way in ("keep", "restore"))
    np.testing.assert_array_equal(kept, restored)


def test_values_beyond_the_limits_are_not_taken_for_clipped():
    noise = SIGMA * np.random.default_rng(1).standard_normal((1, 1000)).astype(np.float32)
    assert find_clipped(1 + noise, np.array([SIGMA])) is None


def test_a_flat_that_merely_lies_near_the_limit_is_not_moved():
    # Half of the image is noisy and cut off, the other half is bright and holds hardly any noise.
    image = flat(1.0)
    image[:, 32:] = 0.97 + 0.0005 * (flat(0.5)[:, 32:] - 0.5) / SIGMA
    restored = smooth_image(image, **{**FIXED, "metric_steps": 0}, clipping="restore").colours
    np.testing.assert_allclose(restored[:, 40:], 0.97, atol=0.002)


def test_the_variance_that_a_limit_leaves_follows_from_the_share_there():
    shares = np.array([1e-3, 0.01, 0.1, 0.2, 0.5, 0.8])
    normal = stats.norm.ppf((np.arange(10**6) + 0.5) / 10**6)
    variances = [np.minimum(normal, limit).var() for limit in stats.norm.isf(shares)]
    # The tails of a million samples.
    np.testing.assert_allclose(variance_of_clipped(shares), variances, rtol=2e-3)
