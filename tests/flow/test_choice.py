"""What is chosen from the data: the estimate of the error is right, and the choice is good, steady and obedient."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.beltrami_flow import choose_parameters, smooth
from beltrami_cli.flow.mesh_manifold import mesh_manifold
from beltrami_cli.flow.parameters import TUNABLE, KernelParameters
from beltrami_cli.flow.records import Step
from beltrami_cli.flow.tuning import mesh_trial, sure
from beltrami_cli.flow.tuning.choice import Choice, Grid, Search
from beltrami_cli.flow.tuning.sure import Risk, RiskEstimate
from beltrami_cli.surface.records import SampledSurface
from oracles import surfaces

SIGMA = 20 / 255
CHOSEN = KernelParameters(free=TUNABLE)


def painting(size=96):
    """Return an image of flat regions and slopes, in [0.25, 0.75], so that noise is hardly cut off."""
    y, x = np.mgrid[:size, :size] / size
    disc = (x - 0.45) ** 2 + (y - 0.5) ** 2 < 0.08
    stripes = (x + y) % 0.4 < 0.2
    layers = [np.where(disc, 0.7, 0.35 + 0.1 * x), np.where(stripes, 0.3, 0.6), 0.3 + 0.4 * y]
    return np.stack(layers, axis=2)


def noisy(clean, sigma=SIGMA, seed=5):
    return (clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape)).astype(np.float32)


def psnr(result, clean):
    return -10 * np.log10(np.mean((np.asarray(result, float) - clean) ** 2))


def edges_of(faces):
    """Return the distinct edges of a closed mesh, each of which two triangles go along in opposite ways."""
    return np.unique(np.sort(faces[:, [0, 1]], axis=1), axis=0).astype(np.int32)


class Blur:
    """A trial whose iterations average over the four neighbours on a torus, weighed by likeness: smooth, not linear."""

    relative = 1.0

    def __init__(self, colours, seed, probes=1):
        self.start = colours
        self.signs = np.random.default_rng(seed).choice(np.float32([-1, 1]), (probes, *colours.shape))

    def step(self, state, step):
        total, weights = state.copy(), np.ones_like(state)
        for axis in (0, 1):
            for way in (1, -1):
                other = np.roll(state, way, axis)
                weight = np.exp(-((step.beta * (other - state)) ** 2) / (4 * step.t))
                total += weight * other
                weights += weight
        return total / weights

    def scored(self, state):
        return state.reshape(-1, state.shape[-1])


@pytest.mark.parametrize(("epsilon", "bias"), [(0.05, 0.0), (sure.PERTURBATION, 0.03)])
def test_the_estimated_error_is_the_true_one(monkeypatch, epsilon, bias):
    """Over many draws of noise and signs, the mean difference is within four of its standard errors.

    A perturbation as large as is used, which makes estimates steady, may add 3 per cent of the noise's variance.
    """
    monkeypatch.setattr(sure, "PERTURBATION", epsilon)
    clean = painting(48)
    step = Step(beta=1.4 / SIGMA, t=2.4, regularised=False)
    differences = []
    for seed in range(40):
        trial = Blur(noisy(clean, seed=seed).astype(np.float64), seed + 1000)
        estimate = RiskEstimate.on(trial, np.full(3, SIGMA))
        state = estimate.step(estimate.step(estimate.start, step), step)
        true = np.mean((state.plain - clean) ** 2)
        differences.append(estimate.of(state).value - true)
    error = np.std(differences, ddof=1) / np.sqrt(len(differences))
    assert abs(np.mean(differences)) < 4 * error + bias * SIGMA**2
    assert error < 0.02 * SIGMA**2  # or the test could not fail


def test_the_estimate_knows_its_own_error():
    """The reported standard error is that of repeated draws, within a factor of two: it comes of 16 parts only."""
    clean = painting(48)
    step = Step(beta=1.4 / SIGMA, t=2.4, regularised=False)
    values, reported = [], []
    for seed in range(30):
        trial = Blur(noisy(clean, seed=seed).astype(np.float64), seed + 1000)
        estimate = RiskEstimate.on(trial, np.full(3, SIGMA))
        state = estimate.step(estimate.start, step)
        found = estimate.of(state)
        values.append(found.value - np.mean((state.plain - clean) ** 2))
        reported.append(found.error)
    assert 0.5 < np.mean(reported) / np.std(values, ddof=1) < 2


def test_more_perturbations_give_the_divergence_more_exactly():
    """Four make half the spread; of twenty draws it is known within a third."""
    clean = painting(24)
    image = noisy(clean).astype(np.float64)
    step = Step(beta=1.4 / SIGMA, t=2.4, regularised=False)
    spread = {}
    for probes in (1, 4):
        estimates = (RiskEstimate.on(Blur(image, seed, probes), np.full(3, SIGMA)) for seed in range(20))
        found = [estimate.of(estimate.step(estimate.start, step)).divergence for estimate in estimates]
        spread[probes] = np.std(found, ddof=1)
    assert 1.3 < spread[1] / spread[4] < 3


def test_signs_of_a_mesh_are_independent():
    """Between perturbations, channels and neighbours; correlations of 7,686 signs are below 0.05."""
    positions, faces = surfaces.icosphere(4)
    colours = noisy(np.full(positions.shape, 0.5))
    edges = edges_of(faces)
    first, second, third = mesh_trial.random_signs(colours, mesh_trial.fingerprints(colours, edges), 3)
    for one, other in ((first, second), (first, third), (second, third)):
        assert abs(np.mean(one * other)) < 0.05
    assert abs(np.mean(first[:, 0] * first[:, 1])) < 0.1
    assert abs(np.mean(first[edges[:, 0]] * first[edges[:, 1]])) < 0.05


@pytest.mark.slow
def test_the_choice_is_near_the_best_on_an_image():
    clean, sigma = painting(), SIGMA
    image = noisy(clean, sigma)
    reached = psnr(beltrami_cli.smooth_image(image, encoding="srgb", space="data").colours, clean)
    best = max(
        psnr(
            beltrami_cli.smooth_image(
                image, space="data", iterations=guided + plain, t=8.0, beta=contrast / sigma,
                beta_growth=1.5, metric_steps=guided,
            ).colours,
            clean,
        )
        for contrast in (0.7, 1.4)
        for guided in (0, 2)
        for plain in (1, 2, 4, 6)
    )  # fmt: skip
    assert reached > best - 0.7
    assert reached > psnr(image, clean) + 6


@pytest.mark.slow
def test_the_choice_is_near_the_best_on_a_mesh():
    positions, faces = surfaces.icosphere(4)
    clean = 0.5 + 0.2 * np.sign(np.sin(5 * positions)) * np.array([1, 0.5, 0.8])
    colours = noisy(clean)
    reached = psnr(beltrami_cli.smooth(positions, faces, colours, space="data").colours, clean)
    best = max(
        psnr(
            beltrami_cli.smooth(
                positions, faces, colours, space="data", iterations=guided + plain, t=2.4, beta=contrast / SIGMA,
                beta_growth=1.5, metric_steps=guided,
            ).colours,
            clean,
        )
        for contrast in (0.7, 1.4)
        for guided in (0, 1)
        for plain in (1, 3)
    )  # fmt: skip
    assert reached > best - 0.7


class Valleys:
    """An estimate of errors that falls towards two places among contrasts and growths, the deeper one far away."""

    def __init__(self, deeper):
        self.start = (0.0, 1.0, 0)
        self._deeper = deeper

    def step(self, state, step):
        beta, _, done = state
        return (step.beta, 1.0, 1) if done == 0 else (beta, step.beta / beta, done + 1)

    def of(self, state):
        beta, growth, done = state
        if done < 2:
            return Risk(1.0, 0.1, 0.0)
        near, far = abs(np.log2(beta / 2.8)) + 4 * (growth > 2), abs(np.log2(beta / 0.7)) + 4 * (growth < 2)
        return Risk(min(0.1 + 0.02 * near, self._deeper + 0.02 * far), 0.01, 0.0)


@pytest.mark.parametrize(("deeper", "beta"), [(0.05, 0.7), (0.2, 2.8)])
def test_the_search_finds_the_deeper_of_two_valleys(deeper, beta):
    """One descent alone would end in the valley next to its start."""
    grid = Grid((0.7, 1.4, 2.8), (1.5, 3.0), 8.0, (0,), 2, 10, ((1, 0, 0), (1, 1, 0)))
    best = Search(Valleys(deeper), grid, noise=1.0).run()
    assert best.beta == beta


class Slope:
    """An estimate of errors that falls by a hundredth with each iteration; counts these."""

    def __init__(self):
        self.start, self.steps = 0, 0

    def step(self, state, step):
        self.steps += 1
        return state + 1

    def of(self, state):
        return Risk(0.99**state, 0.01, 0.0)


@pytest.mark.parametrize(("least_gain", "iterations", "steps"), [(0.0, 10, 10), (0.02, 1, 1)])
def test_a_path_ends_where_an_iteration_gains_too_little(least_gain, iterations, steps):
    grid = Grid((1.0,), (1.0,), 8.0, (0,), None, 10, ((0, 0, 0),), least_gain)
    estimate = Slope()
    assert Search(estimate, grid, noise=1.0).run().plain == iterations
    assert estimate.steps == steps


@pytest.mark.slow
def test_the_choice_does_not_depend_on_threads_or_repetition():
    image = noisy(painting(64))
    first = beltrami_cli.smooth_image(image, space="data", threads=1)
    second = beltrami_cli.smooth_image(image, space="data", threads=3)
    assert first.choice == second.choice
    assert np.array_equal(first.colours, second.colours)


@pytest.mark.slow
def test_the_choice_does_not_depend_on_the_order_of_vertices_or_the_pose():
    positions, faces = surfaces.icosphere(3)
    colours = noisy(np.full((len(positions), 3), 0.5))
    order = np.random.default_rng(2).permutation(len(positions))
    rank = np.argsort(order)
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    one = beltrami_cli.smooth(positions, faces, colours, space="data").choice
    other = beltrami_cli.smooth(positions[order] @ turn, rank[faces], colours[order], space="data").choice
    for name, value in one.chosen.items():
        assert other.chosen[name] == pytest.approx(value, rel=1e-6)


@pytest.mark.slow
def test_a_sample_of_a_mesh_is_enough(monkeypatch):
    """Half as large a sample as is taken leads to within 0.3 dB of the same result, on all of the mesh."""
    positions, faces = surfaces.icosphere(5)
    clean = 0.5 + 0.2 * np.sign(np.sin(5 * positions))
    surface = SampledSurface(positions, faces, np.zeros((0, 3), np.int32), noisy(clean))
    reached = []
    for budget in (mesh_trial.TRIED["least"] // 2, mesh_trial.TRIED["least"]):
        monkeypatch.setitem(mesh_trial.TRIED, "least", budget)
        plan = choose_parameters(mesh_manifold(surface, CHOSEN), CHOSEN)
        assert plan.choice.samples < len(positions) / 2
        reached.append(psnr(smooth(plan).manifold.new_colours().table(), clean))
    assert reached[0] > reached[1] - 0.3


def test_samples_are_enough_on_small_pieces():
    """Patches end at the borders of pieces; then there are more of them."""
    count = 2000
    pairs = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    edges = np.concatenate([pairs[:, :2], pairs[:, 1:], pairs[:, ::2]])
    colours = np.random.default_rng(1).random((3 * count, 3)).astype(np.float32)
    whole = np.concatenate([edges + 3 * count * k for k in range(5)])
    colours = np.concatenate([colours + np.float32(0.01 * k) for k in range(5)])
    chosen = mesh_trial.choose_patches(colours, mesh_trial.fingerprints(colours, whole), whole)
    wanted = mesh_trial.TRIED["least"]
    assert 0.7 * wanted < len(chosen.samples) < 1.3 * wanted
    assert np.all(np.bincount(chosen.samples // 3)[chosen.samples // 3] == 3)


def test_samples_hold_their_share_of_rare_detail():
    """One patch in a dozen is where a twentieth of a surface has all the detail; at random often none is."""
    positions, faces = surfaces.icosphere(5)
    rare = positions[:, 2] > 0.9
    edges = edges_of(faces)
    for seed in range(8):
        colours = np.full((len(positions), 3), 0.5)
        colours[rare] += 0.3 * np.sign(np.sin(40 * positions[rare]))
        colours = (colours + 0.02 * np.random.default_rng(seed).standard_normal(colours.shape)).astype(
            np.float32
        )
        chosen = mesh_trial.choose_patches(colours, mesh_trial.fingerprints(colours, edges), edges)
        assert 0.4 * rare.mean() < rare[chosen.samples[chosen.scored]].mean() < 1.8 * rare.mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    "given", [{"iterations": 2}, {"t": 3.0}, {"beta": 9.0}, {"beta_growth": 1.3}, {"metric_steps": 2}]
)
def test_what_is_given_is_kept(given):
    image = noisy(painting(48))
    choice = beltrami_cli.smooth_image(image, space="data", **given).choice
    (name,) = given
    assert name not in choice.chosen
    assert set(choice.chosen) == set(TUNABLE) - {name}


def test_what_is_given_is_used():
    """Two iterations of the chosen rest are what the flow gives when given all of it."""
    image = noisy(painting(48))
    partly = beltrami_cli.smooth_image(image, space="data", iterations=2)
    reported = beltrami_cli.smooth_image(image, space="data", iterations=2, **partly.choice.chosen)
    assert reported.choice is None
    assert np.array_equal(partly.colours, reported.colours)


def test_nothing_is_chosen_for_a_linear_kernel():
    assert beltrami_cli.smooth_image(noisy(painting(48)), space="data", beta=0).choice is None


@pytest.mark.slow
def test_strength_smooths_less_or_more():
    image = noisy(painting(64))
    change = {}
    for strength in ("gentle", "normal", "strong"):
        for fast in (False, True):
            result = beltrami_cli.smooth_image(image, space="data", strength=strength, fast=fast)
            change[strength, fast] = np.mean((result.colours - image) ** 2)
    for fast in (False, True):
        assert change["gentle", fast] <= change["normal", fast] <= change["strong", fast]
        assert change["gentle", fast] < change["strong", fast]


def test_parameters_know_what_is_open():
    assert CHOSEN.is_open
    assert not KernelParameters().is_open
    assert not dataclasses.replace(CHOSEN, beta=0.0).is_open


def test_the_interval_holds_the_estimate_and_widens_with_the_doubt_of_the_noise():
    sure = Choice({}, 35.0, 0.2, 10.0)
    doubts = (0.0, 0.0), (1e-4, 1e-5), (1e-3, 1e-3)
    intervals = [dataclasses.replace(sure, doubt=doubt).interval for doubt in doubts]
    for least, most in intervals:
        assert least < 35
        assert most is None or most > 35
    assert [least for least, _ in intervals] == sorted((least for least, _ in intervals), reverse=True)
    assert intervals[1][1] is not None
    assert intervals[2][1] is None  # where the doubt is as large as the error, there is no limit
    assert Choice({}).interval is None
