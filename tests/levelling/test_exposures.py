"""Known exposures are found and taken out; paint, and models without exposure steps, stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from beltrami_cli.flow.canvas import painted
from beltrami_cli.levelling.correction import Correction, Levelled, SeamFacts, find_exposures
from beltrami_cli.levelling.fit import Exposures, fit_exposures, known_steps
from beltrami_cli.levelling.hues import LUMA, continue_hues, mixed_cells
from beltrami_cli.levelling.steps import ChartPlaces, Steps, steps_over_seams, weighted_median, with_noise
from beltrami_cli.levelling.verdict import STRONG, Verdict, bridges, judge, pattern_goes_on
from cli.commands import SAMPLES
from levelling.exposure_scene import ExposureScene, error, fall

HEAD, SPHERE = SAMPLES / "head-tex-clean.glb", SAMPLES / "sphere-exr-clean.obj"


@pytest.fixture(scope="module")
def head():
    return ExposureScene.of(HEAD)


@pytest.mark.parametrize(
    ("kind", "least"),
    [({}, 12), ({"clipped": True}, 8), ({"fall_off": True}, 8)],
    ids=["plain", "clipped", "fall-off"],
)
def test_known_exposures_are_taken_out(head, kind, least):
    truth, exposed = head.exposed(1, **kind)
    after, _ = head.levelled(exposed)
    assert fall(exposed, after, truth) >= least


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("head-tex-noisy.glb", 10), ("sphere-exr-clean.obj", 9)])
def test_a_fall_off_that_channels_share_is_found_in_noise_and_on_few_charts(name, least):
    """What charts with noise of 20/255, or six charts, show of it in each channel is too little by itself."""
    scene = ExposureScene.of(SAMPLES / name)
    truth, exposed = scene.exposed(1, fall_off=True)
    assert fall(exposed, scene.levelled(exposed)[0], truth) >= least


@pytest.mark.slow
def test_exposures_are_found_where_jpeg_mixed_hues_over_the_borders_of_charts(head):
    # Who knows the exposures gains 11 dB, and who does not know of the mixing 3.
    truth, exposed = head.exposed(1)
    stored = head.as_jpeg(exposed, 92)
    assert fall(stored.truth, stored.levelled_as_file(), truth) >= 8


@pytest.mark.slow
@pytest.mark.parametrize("name", ["head-tex-clean.glb", "torus-two-clean.gltf"])
def test_a_jpeg_without_exposure_steps_keeps_every_bit(name):
    scene = ExposureScene.of(SAMPLES / name)
    stored = scene.as_jpeg(scene.truth, 85)
    assert np.array_equal(stored.levelled_as_file(), stored.truth)


def test_mixed_hues_become_those_of_their_chart_and_brightness_stays(head):
    atlas, random = head.samples.atlas, np.random.default_rng(3)
    hue = random.uniform(-0.2, 0.2, (atlas.charts, 3))
    hue -= (hue @ LUMA)[:, None]
    grey = random.uniform(0.3, 0.7, (len(head.charts), 1))
    planes = painted(atlas, (grey + hue[head.charts]).astype(np.float32), 1)
    cells, flat = mixed_cells(atlas, [True]), planes.reshape(3, -1)
    wanted = flat[:, cells]
    mixed = random.uniform(-0.2, 0.2, (len(cells), 3))
    flat[:, cells] += (mixed - (mixed @ LUMA)[:, None]).T
    before = flat[:, cells]
    assert np.array_equal(continue_hues(atlas, planes, cells, (0.0, 1.0)), before)
    # Where a chart is so narrow that all is mixed, nothing can be done.
    is_known = np.any(flat[:, cells] != before, axis=0)
    assert is_known.mean() > 0.95
    assert np.abs(flat[:, cells] - wanted)[:, is_known].max() < 1e-5


def test_only_cells_near_borders_in_textures_with_halved_colour_are_mixed():
    scene = ExposureScene.of(SAMPLES / "torus-two-clean.gltf")
    atlas = scene.samples.atlas
    cells = mixed_cells(atlas, [False, True])
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, cells)]
    assert np.all(texels >= atlas.texture_offsets[1])
    assert 0 < len(cells) < 0.1 * len(atlas.owned_cells)
    assert len(mixed_cells(atlas, [False, False])) == 0


def test_two_charts_are_enough():
    scene = ExposureScene.of(SAMPLES / "torus-two-clean.gltf")
    truth, exposed = scene.exposed(3)
    after, _ = scene.levelled(exposed)
    assert fall(exposed, after, truth) >= 12


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("head-tex-noisy.glb", marks=pytest.mark.slow),
        "torus-two-noisy.gltf",
        pytest.param("sphere-exr-clean.obj", marks=pytest.mark.slow),
    ],
)
def test_a_model_without_exposure_steps_keeps_every_bit(name):
    scene = ExposureScene.of(SAMPLES / name)
    after, found = scene.levelled(scene.truth)
    assert np.array_equal(after, scene.truth)
    assert found.exposures is None


@pytest.mark.slow
def test_the_mean_stays(head):
    _, exposed = head.exposed(1)
    after, _ = head.levelled(exposed)
    assert after.mean(axis=0) == pytest.approx(exposed.mean(axis=0), abs=0.2 / 255)


def test_groups_that_no_seam_joins_do_not_keep_the_exposures_of_their_largest_charts():
    truth = np.full((1060, 1), 0.5)
    charts = np.repeat([0, 1, 2, 3, 4, 5, 6], [1000, 10, 10, 10, 10, 10, 10])
    groups = np.array([0, 0, 0, 0, 0, 5, 5])
    terms = np.zeros((1, 7, 2))
    terms[0, :, 1] = [0.08, -0.02, -0.02, -0.02, -0.02, 0.03, -0.03]
    shown = (truth + terms[0, charts, 1:]).astype(np.float32)
    facts = SeamFacts(0, 0, 0, 0.0, 0.0)
    correction = Correction(Levelled(None, Exposures(terms, np.ones(0)), facts, groups), 1.0)
    correction.keep_means(len(shown), lambda rows: (shown[rows], charts[rows], np.zeros((len(rows), 2))))
    after = correction.of(shown, charts, np.zeros((len(shown), 2)))
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


@pytest.mark.slow
def test_half_the_strength_goes_half_the_way(head):
    _, exposed = head.exposed(1)
    whole, half = (head.levelled(exposed, strength)[0] for strength in (1.0, 0.5))
    assert half - exposed == pytest.approx((whole - exposed) / 2, abs=0.05 / 255)


def stripes(scene, chart):
    """Return texels of a chart with other colours painted on it, which vary over it: its seams are painted edges."""
    cells = np.array(np.divmod(scene.samples.atlas.owned_cells, scene.samples.atlas.kind.shape[1])).T
    inside = scene.charts == chart
    pattern = np.sin(cells[inside, 0] / 5)[:, None] * [0.2, 0.25, 0.3] + [0.45, 0.4, 0.35]
    return inside, pattern


@pytest.mark.slow
def test_painted_edges_along_seams_move_by_less_than_a_step(head):
    inside, pattern = stripes(head, 5)
    painted_head = ExposureScene(head.samples, head.truth.copy())
    painted_head.truth[inside] = pattern
    after, _ = painted_head.levelled(painted_head.truth)
    assert np.abs(after - painted_head.truth).mean() < 0.5 / 255
    truth, exposed = painted_head.exposed(1)
    exposed[inside] = np.rint(255 * truth[inside]) / 255  # its own exposure nobody can know
    after, _ = painted_head.levelled(exposed)
    assert np.abs(after - exposed)[inside].mean() < 1 / 255
    assert fall(exposed[~inside], after[~inside], truth[~inside]) >= 12


def steps_of(ends, sides, seams, noise):
    """Return stretches of seams, of one texel each, at which nothing is cut off."""
    count, none = len(seams), np.zeros(sides.shape, bool)
    places, deviation, plain = np.zeros((count, 2, 2)), np.full(count, noise), np.zeros(count, bool)
    return Steps(ends.max() + 1, ends, sides, places, seams, np.ones(count), none, none, deviation, plain)


def seam(paint):
    """Return a seam of two charts with a gain of 1.1 between them, of which a part is painted over on one side."""
    random = np.random.default_rng(4)
    colours = random.uniform(0.3, 0.7, (400, 1))
    sides = np.stack([colours, 1.1 * colours + random.normal(0, 0.002, colours.shape)], axis=1)
    sides[:paint, 1] = 0.9
    return steps_of(np.tile([0, 1], (400, 1)), sides, np.zeros(400, int), 2 / 255)


def test_a_painted_tenth_of_a_seam_does_not_bend_the_rest():
    clean, edged = (fit_exposures(seam(paint), STRONG).sides(seam(0)) for paint in (0, 40))
    assert np.abs(clean[:, 1] - clean[:, 0]).mean() < 1 / 255
    assert np.abs(edged - clean).mean() < 0.5 / 255


@pytest.mark.parametrize(("share", "is_paint"), [(0.48, False), (0.8, True)])
def test_half_a_seam_without_paint_is_enough(share, is_paint):
    random = np.random.default_rng(9)
    sides = 0.5 + random.normal(0, 4 / 255, (4, 100, 2, 3))
    sides[0, : int(100 * share), 1] = random.uniform(0.7, 1, (int(100 * share), 3))
    numbers = np.repeat(np.arange(4), 100)
    steps = steps_of(np.column_stack([numbers, numbers + 1]), sides.reshape(400, 2, 3), numbers, 1 / 255)
    assert with_noise(steps).is_paint.reshape(4, 100)[:, 0].tolist() == [is_paint, False, False, False]


def test_a_long_seam_of_nearly_one_colour_gives_charts_no_gain():
    # An error of 0.7/255 that goes with colours of +-1.5/255 is a gain of 0.5, if all texels are taken for independent.
    random = np.random.default_rng(6)
    shade = random.choice([-1.0, 1.0], (1000, 1))
    sides = np.stack([0.17 + 1.5 * shade / 255, 0.17 + 2.5 * shade / 255], axis=1)
    steps = steps_of(np.tile([0, 1], (1000, 1)), sides, np.zeros(1000, int), 1 / 255)
    steps = replace(steps, counts=np.full(1000, 4.0))
    assert np.abs(fit_exposures(steps, STRONG).terms[..., 0]).max() < STRONG[0]  # what is expected of gains


def test_painted_steps_beside_a_seam_of_exposure_do_not_hide_it():
    # Two thirds of the seams are painted, in steps that no camera makes.
    steps = seam(0)
    painted = np.arange(400) >= 140
    sides = steps.colours.copy()
    sides[painted, 1] = np.where(sides[painted, 0] > 0.5, 0.1, 0.95)
    mixed = replace(steps, colours=sides, seams=np.arange(400) // 20)
    assert judge(mixed).is_sure


def star(pattern):
    """Return the seams of twelve charts with exposures of their own that all meet one chart, and nothing else."""
    random = np.random.default_rng(7)
    seams = np.repeat(np.arange(12), 40)
    colours = np.repeat(random.uniform(0.3, 0.6, (12, 3)), 40, axis=0)
    colours = colours + pattern * random.uniform(-1, 1, (480, 1))
    gain = random.uniform(0.85, 1.1, (12, 3))[seams]
    shown = gain * colours + random.normal(0, 0.002, colours.shape)
    return steps_of(
        np.column_stack([0 * seams, seams + 1]), np.stack([colours, shown], axis=1), seams, 1 / 255
    )


@pytest.mark.slow
def test_a_chart_with_one_seam_is_told_by_the_pattern_that_goes_on_over_it():
    verdict = judge(star(0.15))
    assert verdict.is_sure
    assert len(verdict.left) == 12  # each seam is evidence of its own, however long
    # Of colours without a pattern nobody knows whether these are painted.
    assert not judge(star(0.0)).is_sure


def grid(gains, paint=0.0):
    """Return seams, of 20 stretches, between neighbours of 8 x 8 charts of these gains, some with a step of paint."""
    random, charts = np.random.default_rng(10), np.arange(64).reshape(8, 8)
    ends = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in (
        (charts[:, :-1], charts[:, 1:]), (charts[:-1], charts[1:]))])  # fmt: skip
    is_painted = random.uniform(size=len(ends)) < paint
    step = np.where(is_painted, random.choice([-0.3, 0.3], len(ends)), 0)
    ends, step, seams = (np.repeat(each, 20, axis=0) for each in (ends, step, np.arange(len(ends))))
    colours = random.uniform(0.25, 0.55, (len(seams), 1))
    sides = gains[ends] * (colours + np.column_stack([0 * step, step])) + random.normal(0, 0.002, ends.shape)
    return steps_of(ends, sides[:, :, None], seams, 2 / 255)


# The gains of the benchmark; and those of a surface painted from dark to bright, of which neighbours differ by 17 %, as
# photographs do, but all of them by a deviation of 36 %.
USUAL_GAINS = np.random.default_rng(11).uniform(0.82, 1.12, 64)
GAINS_BEYOND_CAMERAS = np.tile(np.exp(np.linspace(-0.55, 0.55, 8)), 8)


def test_exposures_are_found_beside_some_painted_seams():
    assert find_exposures(grid(USUAL_GAINS, 0.2), 1.0).exposures is not None


@pytest.mark.parametrize(
    "seams", [grid(USUAL_GAINS, 0.5), grid(GAINS_BEYOND_CAMERAS)], ids=["paint", "gains"]
)
def test_painted_seams_and_gains_beyond_those_of_cameras_are_no_exposures(seams):
    found = find_exposures(seams, 1.0)
    assert found.verdict.is_sure
    assert found.exposures is None
    assert found.facts.after == found.facts.before


def painted_charts(pattern):
    """Return seams of 8 x 8 charts of one colour each, which differ as exposures do, and of a line painted at some.

    A pattern is painted over all of it.
    """
    steps, random = grid(np.ones(64)), np.random.default_rng(12)
    own = random.uniform(-10, 10, 64) / 255
    line = random.choice([-10, 0, 10], 112, p=[0.05, 0.9, 0.05]) / 255
    colours = 0.4 + pattern * random.uniform(-1, 1, (len(steps.seams), 1))
    sides = colours + own[steps.ends] + np.column_stack([0 * steps.seams, line[steps.seams]])
    return replace(steps, colours=(sides + random.normal(0, 0.3 / 255, sides.shape))[:, :, None])


@pytest.mark.slow
def test_charts_of_one_colour_each_are_painted_unless_a_pattern_goes_on_over_their_seams():
    plain, patterned = (find_exposures(painted_charts(pattern), 1.0) for pattern in (0.0, 0.05))
    assert plain.verdict.share > 0.5  # as each chart has one colour at all of its seams
    assert plain.exposures is None
    assert patterned.exposures is not None


def test_a_pattern_goes_on_over_a_seam_whatever_gain_and_slope_a_side_has():
    random = np.random.default_rng(13)
    first = random.uniform(0.4, 0.6, (4, 100))
    first[3] = 0.5
    second = first.copy()
    second[0] = 1.1 * first[0] + 0.05
    second[1] += np.linspace(0, 0.3, 100)
    second[2] = first[2, ::-1]
    sides = np.stack([first, second], axis=2).reshape(400, 2, 1)
    seams = np.repeat(np.arange(4), 100)
    steps = steps_of(np.column_stack([seams, seams + 1]), sides, seams, 1 / 255)
    assert pattern_goes_on(steps).reshape(4, 100).all(axis=1).tolist() == [True, True, False, False]
    assert not pattern_goes_on(steps)[200:].any()


@pytest.mark.parametrize(
    ("share", "errors", "seams", "is_sure"),
    [(0.5, 1.5, 9, True), (0.5, 1.5, 120, False), (0.1, 3, 300, False), (0.1, 4.5, 300, True)],
)
def test_a_share_that_few_of_many_seams_foretell_is_not_enough(share, errors, seams, is_sure):
    assert Verdict(STRONG, share, errors, 5 / 255, seams, True, np.zeros(0)).is_sure == is_sure


def test_bridges_are_the_seams_without_which_a_part_is_alone():
    random = np.random.default_rng(8)
    for charts in (1, 2, 9, 30):
        ends = random.integers(0, charts, (charts * 6 // 5, 2))

        def parts(kept, ends=ends, charts=charts):
            graph = coo_array((np.ones(len(kept)), ends[kept].T), shape=(charts,) * 2)
            return connected_components(graph, directed=False)[0]

        every = np.arange(len(ends))
        wanted = [parts(np.delete(every, each)) > parts(every) for each in every]
        assert bridges(ends, charts).tolist() == wanted


def test_a_colour_that_was_cut_off_is_a_bound():
    sides = np.array([[0.9, 1.0], [0.9, 1.0], [0.1, 0.0], [0.1, 0.0], [1.0, 1.0]])[:, :, None]
    steps = steps_of(np.tile([0, 1], (5, 1)), sides, np.zeros(5, int), 1 / 255)
    high, low = sides >= 1, sides <= 0
    steps = replace(steps, high=high, low=low)
    # What was brighter than full scale is at least that, and too bright beside 0.9 ...
    assert known_steps(steps, sides)[:, 0].tolist() == [True, True, True, True, False]
    # ... but not beside what became as bright.
    after = sides.copy()
    after[:2, 0], after[2:4, 0] = 1.05, -0.05
    assert not known_steps(steps, after).any()


def test_white_beside_what_was_brighter_than_full_scale_becomes_as_bright():
    sides = np.tile([[0.85], [1.0]], (400, 1, 1))
    steps = steps_of(np.tile([0, 1], (400, 1)), sides, np.zeros(400, int), 1 / 255)
    found = fit_exposures(replace(steps, high=sides >= 1), STRONG).sides(steps)
    assert np.abs(found[:, 1] - found[:, 0]).max() < 2 / 255


def test_gains_of_light_are_taken_out_of_display_values(head):
    truth, exposed = head.exposed(1, in_light=True)
    assert fall(exposed, head.levelled(exposed)[0], truth) >= 20


def test_steps_are_measured_at_the_seam_without_the_slope_of_the_colours(head):
    # The head's painting is continuous, and slopes on both sides of its seams.
    atlas = head.samples.atlas
    steps = steps_over_seams(atlas, painted(atlas, head.truth.astype(np.float32), 1), ChartPlaces.of(atlas))
    assert (
        weighted_median(np.abs(steps.colours[:, 1] - steps.colours[:, 0]).max(axis=1), steps.counts) < 1 / 255
    )


def test_the_error_of_the_scene_does_not_see_one_gain_and_offset():
    truth = np.random.default_rng(2).random((500, 3))
    assert error(0.7 * truth + 0.1, truth) < 1e-12
