"""Choices from the data: estimates of the error are right, the choice good and obedient; strength scales it."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.choice.prediction import predict
from beltrami_cli.flow.choice.risk import KERNEL_PERTURBATION, Risk, RiskEstimate
from beltrami_cli.flow.choice.search import Candidates, Search
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.mesh.fingerprints import fingerprints, random_signs
from beltrami_cli.flow.manifolds.mesh.trial import choose_discs
from beltrami_cli.flow.manifolds.search_range import BUDGET_ON_MESHES, RULE_ON_GRIDS, RULE_ON_MESHES
from beltrami_cli.flow.noise.model import NoiseModel, Reading
from beltrami_cli.flow.parameters import STRENGTHS, TUNABLE, KernelParameters
from cli.commands import SAMPLES, beltrami
from oracles import surfaces
from oracles.pictures import photograph, psnr, shapes, with_noise

SIGMA = 20 / 255
CHOSEN = KernelParameters(free=TUNABLE)


noisy = partial(with_noise, sigma=SIGMA, seed=5, cut_off=False)


def edges_of(faces):
    """Return the distinct edges of a closed mesh; two triangles go along each in opposite ways."""
    return np.unique(np.sort(faces[:, [0, 1]], axis=1), axis=0).astype(np.int32)


class Blur:
    """A trial whose iterations average over the four neighbours on a torus, weighed by likeness in all channels."""

    relative_variance = 1.0

    def __init__(self, colours, signs):
        self.start, self.signs = colours, signs

    def step(self, state, step):
        total, weights = state.copy(), np.ones((*state.shape[:2], 1))
        for axis in (0, 1):
            for way in (1, -1):
                other = np.roll(state, way, axis)
                apart = np.sum((other - state) ** 2, axis=2, keepdims=True)
                weight = np.exp(-(step.beta**2) * apart / (4 * step.t))
                total += weight * other
                weights += weight
        return total / weights

    def scored(self, state):
        return state.reshape(-1, state.shape[-1])


@pytest.mark.parametrize(("epsilon", "bias", "probes"), [(0.05, 0.0, 1), (KERNEL_PERTURBATION, 0.03, 3)])
def test_the_estimated_error_and_its_own_standard_error_are_the_true_ones(monkeypatch, epsilon, bias, probes):
    """Over many draws of noise and signs, the mean difference is within four of its standard errors.

    A perturbation as large as is used, which makes estimates steady, may add 3 per cent of the noise's variance. The
    reported standard error comes of 16 parts only, and is that of repeated draws within a factor of two.
    """
    monkeypatch.setattr("beltrami_cli.flow.choice.risk.KERNEL_PERTURBATION", epsilon)
    clean = shapes(48)
    step = Step(beta=1.4 / SIGMA, t=2.4, regularised=False)
    differences, reported = [], []
    for seed in range(40):
        signs = np.random.default_rng(seed + 1000).choice([-1.0, 1.0], (probes, *clean.shape))
        estimate = RiskEstimate.on(Blur(noisy(clean, seed=seed).astype(float), signs), np.full(3, SIGMA))
        state = estimate.step(estimate.step(estimate.start, step), step)
        found = estimate.risk(state)
        differences.append(found.value - np.mean((state.plain - clean) ** 2))
        reported.append(found.error)
    spread = np.std(differences, ddof=1)
    assert abs(np.mean(differences)) < 4 * spread / np.sqrt(len(differences)) + bias * SIGMA**2
    assert spread < 0.1 * SIGMA**2  # or the test could not fail
    assert 0.5 < np.mean(reported) / spread < 2


def test_signs_of_a_mesh_are_independent():
    """Between perturbations, channels and neighbours; correlations of 7,686 signs are below 0.05."""
    positions, faces = surfaces.icosphere(4)
    colours = noisy(np.full(positions.shape, 0.5))
    edges = edges_of(faces)
    first, second, third = random_signs(colours, fingerprints(colours, edges), 3)
    for one, other in ((first, second), (first, third), (second, third)):
        assert abs(np.mean(one * other)) < 0.05
    assert abs(np.mean(first[:, 0] * first[:, 1])) < 0.1
    assert abs(np.mean(first[edges[:, 0]] * first[edges[:, 1]])) < 0.05


@pytest.mark.slow
def test_choice_and_fixed_rule_are_not_far_from_the_best():
    """On an image, and on a mesh that is tried in parts; the fixed rule loses most on flat paint."""
    picture, (positions, faces) = shapes(96), surfaces.icosphere(5)
    on_ball = 0.5 + 0.2 * np.sign(np.sin(5 * positions)) * np.array([1, 0.5, 0.8])
    sigma = np.full(len(positions), SIGMA)
    for clean, smooth in (
        (picture, partial(beltrami_cli.smooth_image, noisy(picture), space="data")),
        # With noise that is given for each vertex, also for the parts.
        (on_ball, partial(beltrami_cli.smooth, positions, faces, noisy(on_ball), space="data", noise=sigma)),
    ):
        chosen = smooth()
        given = {"t": 4.0, "beta_growth": 1.5}
        best = max(
            psnr(smooth(**given, iterations=n, beta=contrast / SIGMA, metric_steps=n // 3).colours, clean)
            for contrast in (0.7, 1.4)
            for n in (2, 5)
        )
        assert psnr(chosen.colours, clean) > best - 0.7
        assert psnr(smooth(fast=True).colours, clean) > psnr(chosen.colours, clean) - 4
    assert chosen.choice.samples < len(positions) / 2


def test_the_fixed_rule_smooths_further_where_there_is_more_noise():
    for rule in (RULE_ON_GRIDS, RULE_ON_MESHES):
        counts = [rule.count(noise / 255) for noise in (0, 1, 5, 10, 20, 40, 200)]
        assert counts == sorted(counts)
        assert counts[0] == counts[2] == rule.iterations
        assert counts[3] == rule.iterations + rule.more
        assert counts[-1] == rule.max_iterations


class Valleys:
    """An estimate of errors that falls towards two places among contrasts and growths, the deeper one far away."""

    def __init__(self, deeper):
        self.start, self.mean_variance = (0.0, 1.0, 0), 1.0
        self._deeper = deeper

    def step(self, state, step):
        beta, _, done = state
        return (step.beta, 1.0, 1) if done == 0 else (beta, step.beta / beta, done + 1)

    def risk(self, state):
        beta, growth, done = state
        if done < 2:
            return Risk(1.0, 0.1, 0.0)
        near, far = abs(np.log2(beta / 2.8)) + 4 * (growth > 2), abs(np.log2(beta / 0.7)) + 4 * (growth < 2)
        return Risk(min(0.1 + 0.02 * near, self._deeper + 0.02 * far), 0.01, 0.0)


@pytest.mark.parametrize(("deeper", "beta"), [(0.05, 0.7), (0.2, 2.8)])
def test_the_search_finds_the_deeper_of_two_valleys(deeper, beta):
    """One descent alone would end in the valley next to its start."""
    grid = Candidates((0.7, 1.4, 2.8), (1.5, 3.0), 8.0, (0,), 2, 10, ((1, 0, 0), (1, 1, 0)))
    best = Search(Valleys(deeper), grid).run()
    assert best.beta == beta


def test_samples_are_enough_on_small_pieces():
    """Discs end at the borders of pieces; then there are more of them."""
    count = 2000
    pairs = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    edges = np.concatenate([pairs[:, :2], pairs[:, 1:], pairs[:, ::2]])
    colours = np.random.default_rng(1).random((3 * count, 3)).astype(np.float32)
    whole = np.concatenate([edges + 3 * count * k for k in range(5)])
    colours = np.concatenate([colours + np.float32(0.01 * k) for k in range(5)])
    chosen = choose_discs(colours, fingerprints(colours, whole), whole)
    wanted = BUDGET_ON_MESHES.least
    assert 0.7 * wanted < len(chosen.samples) < 1.3 * wanted
    assert np.all(np.bincount(chosen.samples // 3)[chosen.samples // 3] == 3)


def test_samples_hold_their_share_of_rare_detail():
    """One disc in a dozen is where a twentieth of a surface has all the detail; at random often none is."""
    positions, faces = surfaces.icosphere(5)
    rare = positions[:, 2] > 0.9
    edges = edges_of(faces)
    for seed in range(8):
        colours = np.full((len(positions), 3), 0.5)
        colours[rare] += 0.3 * np.sign(np.sin(40 * positions[rare]))
        colours = with_noise(colours, 0.02, seed, cut_off=False)
        chosen = choose_discs(colours, fingerprints(colours, edges), edges)
        assert 0.4 * rare.mean() < rare[chosen.samples[chosen.scored]].mean() < 1.8 * rare.mean()


GIVEN = {}, {"t": 3.0}, {"beta": 9.0}, {"beta_growth": 1.3}, {"metric_steps": 2}, {"iterations": 2}


@pytest.mark.parametrize(("fast", "given"), [*((True, given) for given in GIVEN), (False, {"iterations": 2})])
def test_what_is_given_is_kept_and_what_is_reported_was_used(fast, given):
    """The flow gives the same when it is given all that was chosen."""
    image = noisy(shapes(48))
    partly = beltrami_cli.smooth_image(image, space="data", fast=fast, **given)
    assert set(partly.choice.chosen) == set(TUNABLE) - set(given)
    assert (partly.choice.candidates == 0) == fast
    reported = beltrami_cli.smooth_image(image, space="data", **given, **partly.choice.chosen)
    assert reported.choice is None
    assert np.array_equal(partly.colours, reported.colours)


def test_parameters_know_whether_any_is_chosen_from_the_data():
    assert CHOSEN.chooses_from_data
    assert not KernelParameters().chooses_from_data
    assert not dataclasses.replace(CHOSEN, beta=0.0).chooses_from_data


def predicted(noise, read=None, *, none=0.0, shared=False, patches=True):
    """Predict the result of an estimate that leaves a tenth of noise of a tenth, by its divergence."""
    model = NoiseModel.independent(np.full(3, noise))
    if shared:
        model = dataclasses.replace(
            model, covariances=np.concatenate([model.covariances, 4 * model.covariances])
        )
    reading = None if read is None else Reading(none, *(noise * factor for factor in read))
    risk = Risk(0.1 * noise**2, 0.01 * noise**2, 0.2 * noise**2)
    return predict(risk, noise**2, dataclasses.replace(model, reading=reading), patches=patches)


def test_the_interval_holds_the_prediction_and_widens_with_the_doubt_of_the_noise():
    widths = []
    for read in (None, (0.9, 1, 1.1), (0.8, 1, 1.2)):
        told = predicted(0.1, read)
        assert told.before == pytest.approx(20)
        assert told.before < told.least < told.psnr < told.most
        assert told.psnr == pytest.approx(30)
        widths.append(told.most - told.least)
    assert widths == sorted(widths)
    assert widths[-1] <= 8
    assert Choice({}).interval is None


@pytest.mark.parametrize(
    "doubt", [{"read": (0.4, 1, 2)}, {"read": (0.9, 1, 1.1), "none": 0.15}, {"shared": True}]
)
def test_nothing_is_predicted_where_the_noise_may_be_other(doubt):
    assert predicted(0.1, **doubt) is None


def test_a_result_that_is_too_smooth_is_not_predicted_by_its_divergence():
    """Without patches, whose noise is all gone, the error is what Stein's estimate says."""
    noise = NoiseModel.independent(np.full(3, 0.1))
    told = predict(Risk(0.005, 1e-4, 0.0), 0.01, noise, patches=False)
    assert told.psnr == pytest.approx(23, abs=0.3)


SIZE = 80


def noise(width, shape, seed=0):
    """Return noise of a standard deviation of 1, which neighbours share up to a width."""
    drawn = np.random.default_rng(seed).standard_normal(shape)
    if width:
        drawn = gaussian_filter(drawn, (width, width, 0))
    return drawn / drawn.std()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "sigma", "channels", "fast"), [(0, 8, 1, False), (0, 20, 3, True), (1.0, 12, 3, False)]
)
def test_stronger_changes_images_more(width, sigma, channels, fast):
    clean = photograph(SIZE, contrast=0.08)[..., :channels]
    noisy = np.clip(clean + sigma / 255 * noise(width, clean.shape), 0, 1).astype(np.float32)
    strengths = sorted({**STRENGTHS, "less": 0.85, "more": 1.25}.values())
    smoothed = [beltrami_cli.smooth_image(noisy, strength=each, fast=fast).colours for each in strengths]
    changes = [float(np.sqrt(np.mean(np.square(colours - noisy)))) for colours in smoothed]
    assert changes == sorted(changes)
    normal = changes[strengths.index(1)]
    assert changes[0] < normal
    assert fast or normal < changes[-1]


def test_words_are_names_of_numbers():
    for name, strength in STRENGTHS.items():
        assert KernelParameters(strength=name) == KernelParameters(strength=strength)


@pytest.mark.parametrize("none", [0.0, 0.1, 0.5, 0.99])
def test_the_assumed_noise_grows_steadily_with_the_strength(none):
    """From the lower end of what may be there to the upper one, if noise is likely; strong assumes what is not."""
    reading = Reading(none, 0.01, 0.02, 0.05)
    assumed = [reading.assumed(each) for each in np.linspace(0.7, 1.5, 9)]
    assert assumed == sorted(assumed)
    assert (assumed[0], assumed[-1]) == ((0.01 if none <= 0.1 else 0.0), 0.05 if none < 0.9 else 0.0)
    assert (assumed[3] > 0) == (none <= 0.1)


def test_the_command_takes_words_and_numbers(tmp_path):
    made = {}
    for strength in ("gentle", 0.7, 0.85):
        made[strength] = tmp_path / f"{strength}.ply"
        words = (SAMPLES / "nonmanifold-noisy.ply", made[strength], "--fast")
        beltrami("smooth", *words, "--strength", strength)
    assert made["gentle"].read_bytes() == made[0.7].read_bytes() != made[0.85].read_bytes()
