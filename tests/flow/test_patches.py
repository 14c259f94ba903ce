"""Patches and their blend with the kernel: cut-off noise, the estimated error, and one result however computed."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from beltrami_cli import SmoothSettings, _native, smooth, smooth_file, smooth_image
from beltrami_cli.flow import beltrami_flow, patches
from beltrami_cli.flow.beltrami_flow import smooth as smooth_plan
from beltrami_cli.flow.clipping import ClippedChannels, normal_tables
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.parameters import PRESETS, KernelParameters, parameters_with
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.job import NoiseSettings
from beltrami_cli.jobs.noise import noise_file
from beltrami_cli.layers.image_surface import ImageSurface, plan_on_image
from flow.split_surfaces import (
    FIXED,
    image_plan,
    outcome,
    same_bits,
    smooth_mesh,
    textured_plan,
    wavy_surface,
)
from flow.test_bands import low_row_blocks
from oracles import surfaces
from oracles.paintings import flat_paint, line_art, photograph, psnr, with_noise

SIGMA = 0.08
# Noise that is the same everywhere.
ONE = np.float32(1)

BOTH = ClippedChannels((True,), (True,), np.array([SIGMA]))
LEVELS = [0.0, 0.02, 0.1, 0.5, 0.93, 1.0]
ON = {**FIXED, "patches": "on"}
RANDOM = np.random.default_rng(7)
SMALL_MESH = wavy_surface(40)
TORUS_TWO = Path(__file__).parents[2] / "sample_data" / "torus-two-clean.gltf"


def cut_off_samples(level, count=200_000):
    return np.clip(level + SIGMA * RANDOM.standard_normal((1, count)), 0, 1).astype(np.float32)


def noise_of_blend(clipped, relative):
    """Return what the core takes: (variance, sigma, low, high) of the channels, tables, and relative variances."""
    rows = np.column_stack([np.square(clipped.sigma), clipped.sigma, clipped.low, clipped.high])
    tables = normal_tables()
    return rows.astype(np.float32), tables.furthest, tables.lost, tables.share, relative


def share_within(true, clipped):
    found = np.empty_like(true)
    relative = np.broadcast_to(ONE, (1, true.shape[1]))
    _native.blend_share_within(true, noise_of_blend(clipped, relative), found, 1)
    return found


def residual(noisy, estimate, clipped):
    found = np.empty_like(noisy)
    relative = np.broadcast_to(ONE, (1, noisy.shape[1]))
    _native.blend_residual(noisy, estimate, noise_of_blend(clipped, relative), found, 1)
    return found


@pytest.mark.parametrize("level", LEVELS)
def test_imputed_samples_have_the_true_mean_and_are_cut_off_as_they_were(level):
    samples = cut_off_samples(level)
    imputed = samples.copy()
    BOTH.impute(imputed, np.full_like(samples, level), ONE)
    # Less scattered than the noise itself, since all at the limit become one value.
    assert abs(imputed.mean(dtype=np.float64) - level) < 4 * SIGMA / np.sqrt(samples.size)
    inside = (samples > 0) & (samples < 1)
    assert np.array_equal(imputed[inside], samples[inside])
    # Of as many samples, the share at a limit deviates by less than this.
    share = float(share_within(np.full((1, 1), level, np.float32), BOTH)[0, 0])
    assert abs(share - inside.mean()) < 4 * 0.5 / np.sqrt(samples.size) + 1e-4
    # What is compared with an estimate is the same as before.
    middle = np.full_like(samples, 0.5)
    assert np.array_equal(residual(imputed, middle, BOTH), residual(samples, middle, BOTH))


@pytest.mark.parametrize("level", LEVELS)
def test_the_residual_of_the_truth_has_no_mean(level):
    samples = cut_off_samples(level)
    mean = residual(samples, np.full_like(samples, level), BOTH).mean(dtype=np.float64)
    assert abs(mean) < 4 * SIGMA / np.sqrt(samples.size)


def test_only_limits_at_which_noise_was_cut_off_count():
    high = ClippedChannels((False, False), (False, True), np.array([SIGMA, SIGMA]))
    colours = np.array([[0.0, 0.5, 1.0]] * 2, np.float32)
    imputed = colours.copy()
    high.impute(imputed, colours, ONE)
    assert np.array_equal(imputed[0], colours[0])
    assert np.array_equal(imputed[1, :2], colours[1, :2])
    assert imputed[1, 2] > 1
    found = residual(colours, colours, high)
    np.testing.assert_allclose([*found[0], *found[1, :2]], 0, atol=1e-9)
    assert found[1, 2] > 0


def clipped_mean_and_share(true, sigma, clipped):
    """Return the mean of normal noise that is cut off, and the share of it that is not, in closed form."""
    mean, share = true.copy(), np.ones_like(true)
    density = np.vectorize(NormalDist().pdf)
    beyond = np.vectorize(lambda a: 1 - NormalDist().cdf(a))
    for k in range(len(true)):
        for at_limit, limit, sign in ((clipped.high[k], 1, -1), (clipped.low[k], 0, 1)):
            a = sign * (true[k] - limit) / sigma[k]
            if at_limit:
                mean[k] += sign * sigma[k] * (density(a) - a * beyond(a))
                share[k] -= beyond(a)
    return mean, share


@pytest.mark.parametrize("probe", [np.int8, np.float32])
@pytest.mark.parametrize("layout", ["planes", "rows"])
def test_stacks_are_added_and_blended_sample_by_sample_on_any_number_of_threads(layout, probe):
    first, second = RANDOM.standard_normal((2, 3, 90, 100)).astype(np.float32)
    weight, added = (
        RANDOM.random((1, 90, 100)).astype(np.float32),
        RANDOM.integers(-1, 2, first.shape).astype(probe),
    )
    if layout == "rows":
        first, second, weight, added = (
            np.moveaxis(part, 0, 2).copy() for part in (first, second, weight, added)
        )
        first, second, weight, added = (np.moveaxis(part, 2, 0) for part in (first, second, weight, added))
    size = np.float32(0.3)
    for threads in (1, 3):
        moved, blended = first.copy(order="K"), first.copy(order="K")
        _native.add_multiple(moved, added, float(size), threads)
        _native.blend(blended, second, weight, threads)
        np.testing.assert_array_equal(moved, first + size * added)
        np.testing.assert_array_equal(blended, first + weight * (second - first))


@pytest.mark.parametrize("in_rows", [False, True])
def test_terms_of_the_blend_are_those_of_the_closed_form(in_rows):
    count = 5000  # more than one run, and no multiple of it
    clipped = ClippedChannels((True, False, True), (True, True, False), np.array([0.1, 0.05, 0.2]))
    noisy, probe, *estimates = RANDOM.uniform(-0.2, 1.2, (6, 3, count)).astype(np.float32)
    relative = RANDOM.uniform(0.3, 3, (1, count)).astype(np.float32)
    sigma = clipped.sigma[:, None] * np.sqrt(relative.astype(np.float64))
    p, q, near_p, near_q = (
        clipped_mean_and_share(own.astype(np.float64), sigma, clipped)[0] for own in estimates
    )
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
    np.testing.assert_allclose(
        shares[0], clipped_mean_and_share(estimates[0].astype(np.float64), sigma, clipped)[1], atol=2e-5
    )


def pixel_plan(image, **parameters):
    values = image.reshape(-1, image.shape[2])
    own = KernelParameters(**{"threads": 2, **parameters})
    return plan_on_image(
        ImageSurface(valid=np.ones(image.shape[:2], bool)), lambda pixels: values[pixels], own
    )


class Seen:
    """Runs flows, and keeps the colours that are blended, and the estimated gain."""

    def __init__(self, monkeypatch):
        monkeypatch.setattr(beltrami_flow, "blend_with_patches", self._blended)

    def _blended(self, manifold, noisy, kernel, *others, blend=patches.blend_with_patches):
        kernels, estimates = [], []

        def seen(run, found):
            def kept(*arguments, **how):
                found.append(run(*arguments, **how).copy())
                return found[-1].copy()

            return kept

        collaborate = seen(manifold.collaborate, estimates)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(type(manifold), "collaborate", lambda _, *given, **how: collaborate(*given, **how))
            done = blend(manifold, noisy, seen(kernel, kernels), *others)
        self.kernel, self.patches = kernels[0], estimates[1]
        self.blend, self.gain = done.colours.copy(), done.gain
        return done

    def errors(self, plan, clean):
        """Return the mean square errors of the kernel, of patches and of the blend, cut off as they are stored."""
        smooth_plan(plan)
        colours = [
            stack.reshape(len(stack), -1)[:, plan.manifold.geometry.atlas.owned_cells].T
            for stack in (self.kernel, self.patches, self.blend)
        ]
        limits = clean.min(), clean.max()
        return [
            np.mean((np.clip(each, *limits) - clean.reshape(-1, clean.shape[2])) ** 2) for each in colours
        ]


def test_the_estimated_gain_is_the_true_one_on_white_noise(monkeypatch):
    clean = photograph(128, contrast=0.1)
    plan = pixel_plan(with_noise(clean, SIGMA, cut_off=False), **{**ON, "iterations": 3})
    known = NoiseModel.independent(np.full(3, SIGMA))
    plan = dataclasses.replace(plan, manifold=dataclasses.replace(plan.manifold, noise=known))
    seen = Seen(monkeypatch)
    kernel, alone, blend = seen.errors(plan, clean)
    # Given w, the estimate scatters by n . d, the noise times the difference of both, over all samples; noise that
    # w follows, and the perturbation that is drawn once, scatter about as much.
    difference = np.sqrt(np.mean((seen.patches - seen.kernel) ** 2))
    scatter = 2 * SIGMA * difference / np.sqrt(clean.size)
    assert abs(seen.gain - (kernel - blend)) < 4 * np.sqrt(3) * scatter + 0.05 * abs(kernel - blend)
    assert blend <= min(kernel, alone) * 1.03


CLEAN = {
    "photograph": photograph,
    "faint photograph": partial(photograph, contrast=0.02),
    "flat paint": flat_paint,
    "line art": line_art,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "sigma"), [("photograph", 10), ("faint photograph", 40), ("flat paint", 5), ("line art", 10)]
)
def test_the_blend_is_as_good_as_the_better_of_kernel_and_patches(name, sigma, monkeypatch):
    """To 0.2 dB, or to a thousandth of the noise: less does not show in an estimate from 50,000 colours."""
    clean = CLEAN[name](128)
    free = ("iterations", "t", "beta", "beta_growth", "metric_steps")
    plan = pixel_plan(with_noise(clean, sigma / 255), free=free)
    kernel, alone, blend = Seen(monkeypatch).errors(plan, clean)
    assert blend < 10**0.02 * min(kernel, alone) + 1e-3 * (sigma / 255) ** 2


def test_plain_areas_are_averaged_over_many_samples(monkeypatch):
    """Three times as many as a group has patches, which differ by noise alone; and means of samples reach further."""
    clean = np.repeat(np.repeat(np.random.default_rng(5).uniform(0.3, 0.7, (2, 2, 3)), 128, 0), 128, 1)
    plan = pixel_plan(with_noise(clean, SIGMA), **ON)
    kernel, alone, blend = Seen(monkeypatch).errors(plan, clean)
    assert alone < SIGMA**2 / (3 * 48)
    assert blend < min(kernel, alone) / 1.3


@pytest.mark.slow
def test_a_plain_texture_loses_little_by_the_patterned_one_beside_it(tmp_path):
    clean, noisy = TORUS_TWO, tmp_path / "noisy.gltf"
    noise_file(clean, noisy, NoiseSettings(sigma=10 / 255))
    found = {}
    for taken in ("off", "on"):
        target = tmp_path / taken / "smooth.gltf"
        target.parent.mkdir()
        smooth_file(noisy, target, SmoothSettings(parameters_with({"patches": taken, "threads": 1})))
        found[taken] = {part["name"]: part["psnr"] for part in compare_files(clean, target).parts}
    gains = {name.split("-")[-1]: found["on"][name] - psnr for name, psnr in found["off"].items()}
    assert gains["icing.png"] > -0.3
    assert gains["dough.png"] > 1


def test_photographs_are_taken_from_patches_and_paint_from_the_kernel():
    shares = []
    for clean in (photograph(64), flat_paint(64)):
        noisy = with_noise(clean, 20 / 255)
        kernel, blend = (smooth_image(noisy, patches=wanted) for wanted in ("off", "auto"))
        assert psnr(blend.colours, clean) > psnr(kernel.colours, clean) - 0.3
        shares.append(blend.patches)
    assert shares[0] > 0.6
    assert shares[1] < 0.2


@pytest.mark.parametrize("make", [textured_plan, image_plan])
def test_on_grids_nothing_depends_on_threads_row_blocks_and_instruction_sets(make, monkeypatch):
    def run(**others):
        return outcome(make(KernelParameters(**{**ON, "threads": 1, **others})))

    whole = run()
    assert not same_bits(whole[:1], run(patches="off")[:1])
    for threads in (2, 3):
        assert same_bits(run(threads=threads), whole)
    for name in instruction_sets(monkeypatch):
        assert same_bits(run(), whole), name
    low_row_blocks(monkeypatch)
    assert same_bits(run(), whole)


def test_on_meshes_nothing_depends_on_threads_and_instruction_sets(monkeypatch):
    def run(**others):
        return smooth_mesh(
            SMALL_MESH, KernelParameters(**{**ON, "solver": "segments", "threads": 1, **others})
        )

    whole = run()
    assert not np.array_equal(whole.colours, run(patches="off").colours)
    for threads in (2, 3):
        assert np.array_equal(run(threads=threads).colours, whole.colours)
    for name in instruction_sets(monkeypatch):
        assert np.array_equal(run().colours, whole.colours), name


def instruction_sets(monkeypatch):
    """Let the core use each instruction set that this machine has, in turn."""
    for name in ("baseline", "x86-64-v3", "x86-64-v4"):
        with monkeypatch.context() as patch:
            patch.setenv("BELTRAMI_SIMD", name)
            try:
                _native.sweep_instruction_set()
            except ValueError:
                continue
            yield name


@pytest.mark.parametrize("make", ["mesh", "pixels"])
def test_progress_goes_up_to_the_work_there_is(make):
    calls = []
    if make == "mesh":
        smooth_mesh(SMALL_MESH, KernelParameters(**ON), progress=lambda *call: calls.append(call))
    else:
        smooth_plan(pixel_plan(with_noise(photograph(130), SIGMA), **ON), lambda *call: calls.append(call))
    assert len({total for _, total in calls}) == 1
    done = [before for before, _ in calls]
    assert done == sorted(done)
    assert 0.9 * calls[0][1] < done[-1] <= calls[0][1]


def test_a_progress_that_raises_ends_the_run_while_patches_are_estimated():
    def stop(done, total):
        if done > total / 2:
            raise KeyboardInterrupt

    for run in (
        partial(smooth_plan, pixel_plan(with_noise(photograph(130), SIGMA), **ON)),
        lambda progress: smooth_mesh(SMALL_MESH, KernelParameters(**ON), progress=progress),
    ):
        with pytest.raises(KeyboardInterrupt):
            run(stop)


def test_channels_that_vary_apart_are_not_mixed():
    clean = photograph(48)
    for image, mixed in (
        (clean, True),
        (np.dstack([clean[..., 0], clean[::-1, :, 0], clean[..., 0].T]), False),
    ):
        plan = pixel_plan(with_noise(image, 0.02), **FIXED)
        mixing = patches.mixing_of(plan.manifold, plan.manifold.colours, plan.manifold.noise.covariance)
        assert np.allclose(mixing.forth @ mixing.back, np.eye(3), atol=1e-6)
        assert np.count_nonzero(mixing.forth[:, 0]) == (3 if mixed else 1)


def test_channels_without_noise_stay_and_do_not_stop_the_others():
    clean = photograph(64)
    constant = np.full((64, 64, 1), 0.37)
    stripes = (np.arange(64) // 8 % 2 * np.ones((64, 1)))[..., None]
    noisy = np.dstack([with_noise(clean, SIGMA), constant, stripes, np.ones_like(constant)]).astype(
        np.float32
    )
    result = smooth_image(noisy)
    # What float32 needs on the diagonal of a system is noise of this order, a fortieth of a step of 8 bits.
    np.testing.assert_allclose(result.colours[..., 3:], noisy[..., 3:], atol=1e-4)
    without = smooth_image(noisy[..., :3])
    assert psnr(result.colours[..., :3], clean) > psnr(without.colours, clean) - 0.2


@pytest.mark.slow
@pytest.mark.parametrize("channels", [1, 2, 6])
def test_any_number_of_channels_is_smoothed(channels):
    clean = np.dstack([photograph(64), photograph(64, seed=2)])[..., :channels]
    noisy = with_noise(clean, SIGMA)
    for parameters in ({}, {"space": "data"}):
        result = smooth_image(noisy, **parameters)
        assert result.patches > 0
        assert psnr(result.colours, clean) > psnr(noisy, clean)


@pytest.mark.parametrize(
    ("parameters", "taken"),
    [
        ({}, True),
        ({"iterations": 2}, False),
        ({"t": 1.0}, False),
        ({"beta": 5.0}, False),
        ({"beta": 0.0}, False),
        ({"fast": True}, False),
        ({"patches": "off"}, False),
        ({"patches": "on", "beta": 5.0, "iterations": 1}, True),
        ({"patches": "on", "fast": True}, True),
        ({"patches": "on", "iterations": 0}, False),
        ({"strength": "strong"}, True),
        (PRESETS["paper"], False),
    ],
)  # fmt: skip
def test_patches_are_taken_where_the_kernel_is_chosen_from_the_data_or_they_are_asked_for(parameters, taken):
    noisy = with_noise(photograph(32), SIGMA)
    positions, faces = surfaces.plane(32, 32)
    assert (smooth_image(noisy, **parameters).patches is not None) == taken
    assert (smooth(positions, faces, noisy.reshape(-1, 3), **parameters).patches is not None) == taken


def test_what_has_no_noise_is_the_same_with_and_without_patches():
    for clean in (flat_paint(64).astype(np.float32), np.zeros((20, 20, 3), np.float32)):
        kernel, both = (smooth_image(clean, patches=wanted) for wanted in ("off", "on"))
        assert both.patches is None
        assert np.array_equal(both.colours, kernel.colours)
