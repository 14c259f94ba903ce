"""Known exposures are found and taken out; edges of colour, and models without exposure steps, stay."""

from dataclasses import replace

import numpy as np
import pytest

from beltrami_cli.flow.manifolds.grid.canvas import on_canvas
from beltrami_cli.levelling import judgement
from beltrami_cli.levelling.correction import Correction
from beltrami_cli.levelling.exposures import SPREADS, Exposures, fit_exposures, known_steps
from beltrami_cli.levelling.hues import LUMA, continue_hues_in_place, mixed_cells
from beltrami_cli.levelling.judgement import CONFIDENCE, judge, judge_steps
from beltrami_cli.levelling.steps import ChartPlaces, Steps, steps_over_seams, weighted_median
from cli.commands import SAMPLES
from levelling.exposure_scene import ExposureScene, fall


@pytest.fixture(scope="module")
def head():
    return ExposureScene.of(SAMPLES / "head-tex-clean.glb")


@pytest.mark.slow
def test_known_exposures_are_taken_out_by_half_or_whole_and_the_mean_stays(head):
    truth, exposed = head.exposed(1)
    whole, half = (head.levelled(exposed, strength)[0] for strength in (1.0, 0.5))
    assert fall(exposed, whole, truth) >= 12
    assert whole.mean(axis=0) == pytest.approx(exposed.mean(axis=0), abs=0.2 / 255)
    assert half - exposed == pytest.approx((whole - exposed) / 2, abs=0.05 / 255)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind", "least"),
    [
        ("head-tex-clean.glb", {"clipped": True}, 8),
        ("head-tex-clean.glb", {"fall_off": True}, 8),
        ("head-tex-clean.glb", {"in_light": True}, 20),
        ("torus-two-clean.gltf", {}, 12),  # two charts are enough
        # A fall-off that channels share: what charts with noise, or six charts, show of it in each is too little.
        ("head-tex-noisy.glb", {"fall_off": True}, 10),
        ("sphere-exr-clean.obj", {"fall_off": True}, 9),
    ],
)
def test_known_exposures_of_each_kind_are_taken_out(name, kind, least):
    scene = ExposureScene.of(SAMPLES / name)
    truth, exposed = scene.exposed(1, **kind)
    assert fall(exposed, scene.levelled(exposed)[0], truth) >= least


@pytest.mark.slow
def test_exposures_are_found_where_jpeg_mixed_hues_over_the_borders_of_charts(head):
    # Who knows the exposures gains 11 dB, and who does not know of the mixing 3.
    truth, exposed = head.exposed(1)
    stored = head.as_jpeg(exposed, 92)
    assert fall(stored.truth, stored.levelled_as_file(), truth) >= 8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "quality"),
    [
        ("head-tex-noisy.glb", None), ("torus-two-noisy.gltf", None), ("sphere-exr-clean.obj", None),
        ("head-tex-clean.glb", 85), ("torus-two-clean.gltf", 85),
    ],
)  # fmt: skip
def test_a_model_without_exposure_steps_keeps_every_bit(name, quality):
    scene = ExposureScene.of(SAMPLES / name)
    if quality:
        scene = scene.as_jpeg(scene.truth, quality)
    assert np.array_equal(scene.levelled_as_file(), scene.truth)


def test_mixed_hues_become_those_of_their_chart_and_brightness_stays(head):
    atlas, random = head.samples.atlas, np.random.default_rng(3)
    hue = random.uniform(-0.2, 0.2, (atlas.charts, 3))
    hue -= (hue @ LUMA)[:, None]
    grey = random.uniform(0.3, 0.7, (len(head.charts), 1))
    planes = on_canvas(atlas, (grey + hue[head.charts]).astype(np.float32))
    cells, flat = mixed_cells(atlas, [2]), planes.reshape(3, -1)
    wanted = flat[:, cells]
    mixed = random.uniform(-0.2, 0.2, (len(cells), 3))
    flat[:, cells] += (mixed - (mixed @ LUMA)[:, None]).T
    before = flat[:, cells]
    assert np.array_equal(continue_hues_in_place(atlas, planes, cells, 2), before)
    # Where a chart is so narrow that all is mixed, nothing can be done.
    is_known = np.any(flat[:, cells] != before, axis=0)
    assert is_known.mean() > 0.95
    assert np.abs(flat[:, cells] - wanted)[:, is_known].max() < 1e-5


def test_only_cells_near_borders_in_textures_with_halved_colour_are_mixed():
    scene = ExposureScene.of(SAMPLES / "torus-two-clean.gltf")
    atlas = scene.samples.atlas
    cells = mixed_cells(atlas, [1, 2])
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, cells)]
    assert np.all(texels >= atlas.texture_offsets[1])
    assert 0 < len(cells) < 0.1 * len(atlas.owned_cells)
    assert len(mixed_cells(atlas, [1, 1])) == 0


def test_groups_that_no_seam_joins_do_not_keep_the_exposures_of_their_largest_charts():
    truth = np.full((1060, 1), 0.5)
    charts = np.repeat([0, 1, 2, 3, 4, 5, 6], [1000, 10, 10, 10, 10, 10, 10])
    groups = np.array([0, 0, 0, 0, 0, 5, 5])
    terms = np.zeros((1, 7, 2))
    terms[0, :, 1] = [0.08, -0.02, -0.02, -0.02, -0.02, 0.03, -0.03]
    shown = (truth + terms[0, charts, 1:]).astype(np.float32)
    correction = Correction.of(Exposures(terms, np.ones(0)), groups, 1.0, np.zeros(7, bool))
    correction, _ = correction.preserving_means(
        len(shown), lambda rows: (shown[rows], charts[rows], np.zeros((len(rows), 2)))
    )
    after = correction.corrected(shown, charts, np.zeros((len(shown), 2)))
    assert np.ptp(after) < 1e-6
    assert after.mean() == pytest.approx(shown.mean(), abs=1e-6)


@pytest.mark.slow
def test_reference_charts_keep_every_bit_and_give_the_others_their_exposure(head):
    truth, exposed = head.exposed(1)
    fixed = np.arange(head.samples.atlas.charts) == 3
    inside = fixed[head.charts]
    exposed[inside] = truth[inside].astype(np.float32)
    after, _ = head.levelled(exposed, fixed=fixed)
    assert np.array_equal(after[inside], exposed[inside])
    assert np.sqrt(np.mean(np.square(after - truth))) < 0.25 * np.sqrt(np.mean(np.square(exposed - truth)))


def stripes(scene, chart):
    """Return texels of a chart with other colours on it, which vary over it: its seams are edges of colour."""
    cells = np.array(np.divmod(scene.samples.atlas.owned_cells, scene.samples.atlas.kind.shape[1])).T
    inside = scene.charts == chart
    pattern = np.sin(cells[inside, 0] / 5)[:, None] * [0.2, 0.25, 0.3] + [0.45, 0.4, 0.35]
    return inside, pattern


@pytest.mark.slow
def test_colour_edges_along_seams_move_by_less_than_a_step(head):
    inside, pattern = stripes(head, 5)
    outlier_head = ExposureScene(head.samples, head.truth.copy())
    outlier_head.truth[inside] = pattern
    after, _ = outlier_head.levelled(outlier_head.truth)
    assert np.abs(after - outlier_head.truth).mean() < 0.5 / 255
    truth, exposed = outlier_head.exposed(1)
    exposed[inside] = np.rint(255 * truth[inside]) / 255  # its own exposure cannot be known
    after, _ = outlier_head.levelled(exposed)
    assert np.abs(after - exposed)[inside].mean() < 1 / 255
    assert fall(exposed[~inside], after[~inside], truth[~inside]) >= 12


def steps_of(ends, sides, seams):
    """Return stretches of seams, of four texels each, at which nothing is cut off."""
    fixed, none = np.zeros(ends.max() + 1, bool), np.zeros(sides.shape, bool)
    places, counts = np.zeros((len(seams), 2, 2)), np.full(len(seams), 4.0)
    return Steps(fixed, ends, sides, places, seams, counts, none, none)


def seam(outliers):
    """Return a seam of two charts with a gain of 1.1 between them; a part is recoloured on one side."""
    random = np.random.default_rng(4)
    colours = random.uniform(0.3, 0.7, (400, 1))
    sides = np.stack([colours, 1.1 * colours + random.normal(0, 0.002, colours.shape)], axis=1)
    sides[:outliers, 1] = 0.9
    return steps_of(np.tile([0, 1], (400, 1)), sides, np.zeros(400, int))


def test_a_recoloured_tenth_of_a_seam_does_not_bend_the_rest():
    clean, edged = (fit_exposures(seam(outliers), SPREADS["plain"]).sides(seam(0)) for outliers in (0, 40))
    assert np.abs(clean[:, 1] - clean[:, 0]).mean() < 1 / 255
    assert np.abs(edged - clean).mean() < 0.5 / 255


def test_a_long_seam_of_nearly_one_colour_gives_charts_no_gain():
    # An error of 0.7/255 that goes with colours of +-1.5/255 is a gain of 0.5, if all texels are taken for independent.
    random = np.random.default_rng(6)
    shade = random.choice([-1.0, 1.0], (1000, 1))
    sides = np.stack([0.17 + 1.5 * shade / 255, 0.17 + 2.5 * shade / 255], axis=1)
    steps = steps_of(np.tile([0, 1], (1000, 1)), sides, np.zeros(1000, int))
    expected, _ = spread = SPREADS["plain"]
    assert np.abs(fit_exposures(steps, spread).terms[..., 0]).max() < expected


def grid(across, pattern, seed, gains=None, step=0.0):
    """Return seams, of 16 stretches, between neighbours of a square of charts, with a pattern that crosses them.

    `gains`: of charts; `step`: deviation of steps, each of a whole seam, that charts do not explain.
    """
    random, charts = np.random.default_rng(seed), np.arange(across**2).reshape(across, across)
    ends = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in (
        (charts[:, :-1], charts[:, 1:]), (charts[:-1], charts[1:]))])  # fmt: skip
    steps = np.repeat(random.normal(0, step, len(ends)), 16)
    seams, ends = np.repeat(np.arange(len(ends)), 16), np.repeat(ends, 16, axis=0)
    colours = 0.4 + pattern * random.uniform(-1, 1, (len(seams), 1))
    sides = colours + np.column_stack([-steps, steps]) / 2
    sides = (1 if gains is None else gains[ends]) * sides + random.normal(0, 0.5 / 255, ends.shape)
    return steps_of(ends, sides[:, :, None], seams)


@pytest.mark.slow
def test_steps_that_charts_do_not_explain_pass_no_more_often_than_the_test_says():
    """Of 8 models, at most one passes with a probability of 0.98 if 1 - CONFIDENCE of them do. Takes 2 s."""
    steps = (0.5 / 255, 10 / 255)  # which rounding hides, and of the size that exposures have
    passed = [judge(grid(3, 0.1, seed, step=steps[seed % 2])).confidence >= CONFIDENCE for seed in range(8)]
    assert CONFIDENCE >= 0.975
    assert sum(passed) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("brightness", [0.5, 1.5])
def test_exposures_are_found_at_any_brightness_and_taken_out(brightness):
    gains = brightness * np.random.default_rng(3).uniform(0.85, 1.15, 16)
    steps = grid(4, 0.1, 4, gains)
    verdict = judge(steps)
    assert verdict.is_sure
    left = np.diff(fit_exposures(steps, verdict.spread).sides(steps), axis=1)
    assert np.abs(left).mean() < 0.2 * np.abs(np.diff(steps.colours, axis=1)).mean()


@pytest.mark.parametrize(
    ("steps", "is_sure"),
    [
        (grid(4, 0.1, 5, np.full(16, 0.8)), False),
        (seam(0).select(np.arange(400) < 1), False),
        (seam(0), True),  # by the pattern that crosses it
    ],
    ids=["one exposure of all charts", "a seam of one stretch", "a long seam"],
)
def test_what_seams_say_of_exposures(steps, is_sure):
    assert judge(steps).is_sure == is_sure


def counted_fits(monkeypatch):
    """Return a list that gets an entry for each fit of exposures."""
    fits = []

    def fit(*arguments):
        fits.append(arguments)
        return fit_exposures(*arguments)

    monkeypatch.setattr(judgement, "fit_exposures", fit)
    return fits


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.5 / 255, 3 / 255], ids=["hidden by rounding", "visible"])
@pytest.mark.parametrize("spread", [0.0, 0.15], ids=["one exposure", "exposures"])
def test_a_test_that_ends_early_decides_as_the_whole_one_does(monkeypatch, spread, step):
    gains = np.random.default_rng(3).uniform(1 - spread, 1 + spread, 81)
    steps, fits = grid(9, 0.1, 7, gains, step), counted_fits(monkeypatch)
    early = judge(steps)
    needed = len(fits)
    monkeypatch.setattr(judgement, "CURTAILMENT", 1e6)
    whole = judge(steps)
    assert needed < len(fits) - needed
    assert (early.is_sure, early.spread) == (whole.is_sure, whole.spread)
    assert early.is_sure == (spread > 0)


@pytest.mark.slow
def test_nothing_is_fitted_without_steps(monkeypatch):
    fits = counted_fits(monkeypatch)
    assert judge_steps(grid(4, 0.1, 8)) is None
    assert not fits
    assert judge_steps(grid(4, 0.1, 8, step=10 / 255)) is not None
    assert fits


@pytest.mark.slow
def test_charts_of_unrelated_textures_are_kept_however_well_exposures_explain_their_steps():
    plain = grid(4, 0.0, 6, np.random.default_rng(6).uniform(0.9, 1.1, 16))
    noise = np.random.default_rng(7).normal(0, 6 / 255, plain.colours.shape)
    verdict = judge(replace(plain, colours=plain.colours + noise))
    assert verdict.confidence >= CONFIDENCE
    assert not verdict.is_sure


def test_a_colour_that_was_cut_off_is_a_bound():
    sides = np.array([[0.9, 1.0], [0.9, 1.0], [0.1, 0.0], [0.1, 0.0], [1.0, 1.0]])[:, :, None]
    steps = steps_of(np.tile([0, 1], (5, 1)), sides, np.zeros(5, int))
    high, low = sides >= 1, sides <= 0
    steps = replace(steps, high=high, low=low)
    # What was brighter than full scale is at least that, and too bright next to 0.9 ...
    assert known_steps(steps, sides)[:, 0].tolist() == [True, True, True, True, False]
    # ... but not next to colours that became as bright.
    after = sides.copy()
    after[:2, 0], after[2:4, 0] = 1.05, -0.05
    assert not known_steps(steps, after).any()


def test_white_beside_what_was_brighter_than_full_scale_becomes_as_bright():
    sides = np.tile([[0.85], [1.0]], (400, 1, 1))
    steps = steps_of(np.tile([0, 1], (400, 1)), sides, np.zeros(400, int))
    found = fit_exposures(replace(steps, high=sides >= 1), SPREADS["plain"]).sides(steps)
    assert np.abs(found[:, 1] - found[:, 0]).max() < 2 / 255


def test_steps_are_measured_at_the_seam_without_the_slope_of_the_colours(head):
    # The head's phantom is continuous, and slopes on both sides of its seams.
    atlas = head.samples.atlas
    planes, fixed = on_canvas(atlas, head.truth.astype(np.float32)), np.zeros(atlas.charts, bool)
    steps = steps_over_seams(atlas, planes, ChartPlaces.of(atlas), fixed)
    sizes = np.abs(steps.colours[:, 1] - steps.colours[:, 0]).max(axis=1)
    assert weighted_median(sizes, steps.counts) < 1 / 255
