"""Patches and their blend with the kernel: cut-off noise, the estimated error, and one result however computed."""

from statistics import NormalDist

import numpy as np
import pytest

from beltrami_cli import _native, smooth, smooth_image
from beltrami_cli.flow.corrections.clipping import ClippedChannel, ClippedChannels
from beltrami_cli.flow.corrections.normal_tables import normal_tables
from beltrami_cli.flow.parameters import PRESETS
from oracles import surfaces
from oracles.pictures import flat_areas, line_art, photograph, psnr, with_noise

SIGMA = 0.08
# Noise that is the same everywhere.
ONE = np.float32(1)

BOTH = ClippedChannels((ClippedChannel(SIGMA, True, True),))
LEVELS = [0.0, 0.02, 0.1, 0.5, 0.93, 1.0]
RANDOM = np.random.default_rng(7)


def cut_off_samples(level, count=200_000):
    return np.clip(level + SIGMA * RANDOM.standard_normal((1, count)), 0, 1).astype(np.float32)


def noise_of_blend(clipped, relative):
    """Return what the core takes: (variance, sigma, low, high) of the channels, tables, and relative variances."""
    rows = np.array([(sigma**2, sigma, low, high) for sigma, low, high in clipped.channels], np.float32)
    tables = normal_tables()
    return rows, tables.furthest, tables.lost, tables.share, relative


def residual(noisy, estimate, clipped):
    found = np.empty_like(noisy)
    relative = np.broadcast_to(ONE, (1, noisy.shape[1]))
    _native.blend_residual(noisy, estimate, noise_of_blend(clipped, relative), found, 1)
    return found


@pytest.mark.parametrize("level", LEVELS)
def test_the_residual_of_the_truth_has_no_mean(level):
    samples = cut_off_samples(level)
    mean = residual(samples, np.full_like(samples, level), BOTH).mean(dtype=np.float64)
    assert abs(mean) < 4 * SIGMA / np.sqrt(samples.size)


def clipped_mean_and_share(true, sigma, clipped):
    """Return the mean of normal noise that is cut off, and the share of it that is not, in closed form."""
    mean, share = true.copy(), np.ones_like(true)
    density = np.vectorize(NormalDist().pdf)
    beyond = np.vectorize(lambda a: 1 - NormalDist().cdf(a))
    for k in range(len(true)):
        for at_limit, limit, sign in ((clipped.channels[k].high, 1, -1), (clipped.channels[k].low, 0, 1)):
            a = sign * (true[k] - limit) / sigma[k]
            if at_limit:
                mean[k] += sign * sigma[k] * (density(a) - a * beyond(a))
                share[k] -= beyond(a)
    return mean, share


@pytest.mark.parametrize("in_rows", [False, True])
def test_terms_of_the_blend_are_those_of_the_closed_form(in_rows):
    count = 5000  # more than one run, and no multiple of it
    sides = (0.1, True, True), (0.05, False, True), (0.2, True, False)
    clipped = ClippedChannels(tuple(ClippedChannel(*each) for each in sides))
    noisy, probe, *estimates = RANDOM.uniform(-0.2, 1.2, (6, 3, count)).astype(np.float32)
    relative = RANDOM.uniform(0.3, 3, (1, count)).astype(np.float32)
    sigma = np.array(sides)[:, :1] * np.sqrt(relative.astype(np.float64))
    estimates64 = [own.astype(np.float64) for own in estimates]
    p, q, near_p, near_q = (clipped_mean_and_share(own, sigma, clipped)[0] for own in estimates64)
    within = clipped_mean_and_share((estimates[0] + estimates[1]) / 2.0, sigma, clipped)[1]
    z = noisy.copy()
    z[[0, 2]] = np.maximum(z[[0, 2]], 0)
    z[[0, 1]] = np.minimum(z[[0, 1]], 1)
    change = q - p
    slope = (z - p) * change - np.square(sigma) * within * probe * (near_q - near_p - change)
    stacks = [noisy, probe, *estimates]
    if in_rows:
        stacks = [np.ascontiguousarray(stack.T).T for stack in stacks]
    found, shares = [], []
    for threads in (1, 2):
        terms, share = np.empty((2, count), np.float32), np.empty((3, count), np.float32)
        noise = noise_of_blend(clipped, relative)
        _native.blend_terms(*stacks[:2], tuple(stacks[2:]), noise, terms, threads)
        _native.blend_share_within(stacks[2], noise, share, threads)
        found.append(terms)
        shares.append(share)
    assert np.array_equal(*found)
    assert np.array_equal(*shares)
    # Linear interpolation in steps of 1/256 errs by 1/8 of the squared step times a second derivative of at most 0.4,
    # in units of sigma; each term is a sum of a dozen such values and their roundings, times differences below 2.
    np.testing.assert_allclose(found[0][0], slope.sum(axis=0), atol=2e-5)
    np.testing.assert_allclose(found[0][1], np.square(change).sum(axis=0), atol=2e-5)
    _, expected = clipped_mean_and_share(estimates64[0], sigma, clipped)
    np.testing.assert_allclose(shares[0], expected, atol=2e-5)


@pytest.mark.slow
@pytest.mark.uninstrumented
@pytest.mark.parametrize(("clean", "sigma"), [(photograph, 20), (flat_areas, 5), (line_art, 10)])
def test_the_blend_is_hardly_worse_than_kernel_or_patches_alone(clean, sigma):
    """Photographs are taken from patches, and paint from the kernel."""
    truth = clean(96)
    noisy = with_noise(truth, sigma / 255)
    kernel, blend = (smooth_image(noisy, patches=wanted) for wanted in ("off", "auto"))
    assert psnr(blend.colours, truth) > psnr(kernel.colours, truth) - 0.3
    assert (blend.patches > 0.6) == (clean is photograph)


def test_channels_without_noise_stay_and_do_not_stop_the_others():
    clean = photograph(64)
    constant = np.full((64, 64, 1), 0.37)
    stripes = (np.arange(64) // 8 % 2 * np.ones((64, 1)))[..., None]
    others = (constant, stripes, np.ones_like(constant))
    noisy = np.dstack([with_noise(clean, SIGMA), *others]).astype(np.float32)
    result = smooth_image(noisy)
    # What float32 needs on the diagonal of a system is noise of this order, a fortieth of a step of 8 bits.
    np.testing.assert_allclose(result.colours[..., 3:], noisy[..., 3:], atol=1e-4)
    without = smooth_image(noisy[..., :3])
    assert psnr(result.colours[..., :3], clean) > psnr(without.colours, clean) - 0.2


@pytest.mark.parametrize(
    ("parameters", "taken"),
    [
        ({}, True), ({"iterations": 2}, False), ({"t": 1.0}, False), ({"beta": 5.0}, False), ({"beta": 0.0}, False),
        ({"fast": True}, False), ({"patches": "off"}, False),
        ({"patches": "on", "beta": 5.0, "iterations": 1}, True), ({"patches": "on", "fast": True}, True),
        ({"patches": "on", "iterations": 0}, False), ({"strength": "strong"}, True), (PRESETS["paper"], False), ],
)  # fmt: skip
def test_patches_are_taken_where_the_kernel_is_chosen_from_the_data_or_they_are_asked_for(parameters, taken):
    noisy = with_noise(photograph(32), SIGMA)
    positions, faces = surfaces.plane(32, 32)
    assert (smooth_image(noisy, **parameters).patches is not None) == taken
    assert (smooth(positions, faces, noisy.reshape(-1, 3), **parameters).patches is not None) == taken


def test_what_has_no_noise_is_the_same_with_and_without_patches():
    for clean in (flat_areas(64).astype(np.float32), np.zeros((20, 20, 3), np.float32)):
        kernel, both = (smooth_image(clean, patches=wanted) for wanted in ("off", "on"))
        assert both.patches is None
        assert np.array_equal(both.colours, kernel.colours)


def test_with_patches_the_samples_of_kernels_are_still_those_of_the_given_colours():
    """Patches also run the kernel on perturbed colours; the report counts no kernels of these."""
    positions, faces = surfaces.plane(24, 24)
    noisy = with_noise(photograph(24).reshape(-1, 3), SIGMA)
    kernel, both = (
        smooth(positions, faces, noisy, iterations=2, t=2.0, beta=8.0, max_samples=12, patches=patches)
        for patches in ("off", "on")
    )
    assert both.patches is not None
    assert (both.samples_per_kernel, both.truncated) == (kernel.samples_per_kernel, kernel.truncated)
