"""Guides: channels that enter the metric and stay as they are; and colours that change without entering it."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.manifolds.grid.gaussian import gaussian_reach
from beltrami_cli.flow.manifolds.guides import Guide, choose_guide_beta
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface.atlas import build_atlas
from oracles import surfaces
from properties.textured_planes import Board, phantom, smoothed, texel_plan

SIDE = 48
POSITIONS, FACES = surfaces.plane(SIDE, SIDE)
MASK = ((POSITIONS[:, 0] + 0.4 * POSITIONS[:, 1]) % 16 > 8).astype(float)
# Stripes of 8 samples that differ by 30 of 255, in noise of 60.
STRIPES = 0.5 + 0.12 * MASK[:, None] * np.array([1.0, 0.3, -0.6])
NOISY = STRIPES + np.random.default_rng(2).normal(0, 60 / 255, STRIPES.shape)


# Given, so that they are not chosen from the data, which differ between the two sides of a comparison.
FIXED = {"iterations": 5, "t": 2.4, "beta": 6.0, "beta_growth": 1.5, "metric_steps": 2}


def on_mesh(colours=NOISY, **parameters):
    return beltrami_cli.smooth(POSITIONS, FACES, colours, **{**FIXED, **parameters}).colours


def on_image(colours=NOISY, guide=None, **parameters):
    image = colours.reshape(SIDE, SIDE, -1)
    guide = None if guide is None else guide.reshape(SIDE, SIDE, -1)
    smoothed = beltrami_cli.smooth_image(image, guide=guide, **{**FIXED, **parameters}).colours
    return smoothed.reshape(colours.shape)


both = pytest.mark.parametrize("smooth", [on_mesh, on_image])


@both
def test_the_two_sides_of_a_guiding_edge_do_not_mix(smooth):
    colours = np.repeat(MASK[:, None], 2, axis=1)
    kept = smooth(colours, guide=MASK, beta=0, guide_betas=(1000.0,))
    assert np.array_equal(kept, colours.astype(np.float32))
    assert np.abs(smooth(colours, beta=0) - colours).max() > 0.3


@both
@pytest.mark.parametrize("beta", [2.0, 7.0])
def test_the_colours_as_their_own_guide_count_like_a_larger_beta(smooth, beta):
    # beta^2 |dI|^2 + beta^2 |dI|^2 = (sqrt(2) beta)^2 |dI|^2; in the first iteration guide and colours are the same.
    parameters = {"iterations": 1, "metric_steps": 0, "t": 0.7, "clipping": "keep"}
    guided = smooth(guide=NOISY, guide_betas=(beta,), beta=beta, **parameters)
    larger = smooth(beta=np.sqrt(2) * beta, **parameters)
    # Distances differ by rounding, so that a sample at the cut-off, of weight 0.01 among some 10, may come or go.
    assert np.mean(np.abs(guided - larger)) < 1e-5
    assert np.mean(np.abs(larger - smooth(beta=beta, **parameters))) > 1e-3


@both
@pytest.mark.parametrize(
    ("given", "same"),
    [
        ({"guide": np.full(len(NOISY), 0.3)}, {}),
        ({"guide": np.full(len(NOISY), 0.3), "guide_betas": (3.0,)}, {}),
        ({"guide": MASK, "guide_betas": (0.0,)}, {}),
        ({"metric_channels": []}, {"beta": 0}),
    ],
    ids=["constant", "constant with a weight", "without weight", "no channels"],
)
def test_what_tells_nothing_of_edges_changes_nothing(smooth, given, same):
    assert np.array_equal(smooth(**given), smooth(**same))


@both
def test_the_default_weight_follows_the_unit_of_the_guide(smooth):
    guide = np.random.default_rng(1).normal(size=len(NOISY)) + 9 * MASK
    # A power of two is exact, and so is the shift of such numbers.
    assert np.array_equal(smooth(guide=guide), smooth(guide=1024 * guide))
    assert np.allclose(smooth(guide=guide), smooth(guide=5e5 + guide), atol=2e-3)


def test_the_default_weight_lets_neither_noise_nor_slopes_stop_a_kernel():
    values = np.random.default_rng(1).normal(0, 0.1, (100_000, 2))
    # White noise of deviation s has steps of deviation sqrt(2) s: they count 2/3 sqrt(2) spacings a channel, or 6 / s
    # times s if that were less.
    beta = choose_guide_beta(values.astype(np.float32), np.diff(values, axis=0).astype(np.float32))
    assert beta == pytest.approx(2 / 3 / 0.1, rel=0.02)
    step = np.repeat([0.0, 4.0], 1000)[:, None].astype(np.float32)
    assert choose_guide_beta(step, np.diff(step, axis=0)) == pytest.approx(6 / 2.0)
    assert choose_guide_beta(np.ones((5, 1), np.float32), np.zeros((4, 1), np.float32)) == 0


@both
def test_only_the_metric_channels_make_distances(smooth):
    parameters = {"beta": 6.0, "clipping": "keep"}
    first = smooth(NOISY[:, :1], **parameters)[:, 0]
    # With channel 0 alone in the metric, it is smoothed as if it were alone, and the others by the same kernel.
    chosen = smooth(metric_channels=[0], **parameters)
    rounded = {"rtol": 1e-6}  # the other channels have a part in the unit
    np.testing.assert_allclose(chosen[:, 0], first, **rounded)
    assert not np.array_equal(chosen, smooth(**parameters))
    thrice = smooth(np.repeat(NOISY[:, :1], 3, axis=1), metric_channels=[0], **parameters)
    np.testing.assert_allclose(thrice, np.repeat(first[:, None], 3, axis=1), **rounded)


def with_guide(surface, image, guide, beta=5.0, in_chart_frame=False):
    """Smooth an image over a surface, guided by another of the same size."""
    kernel = KernelParameters(threads=1, metric_steps=0, beta=3.0)
    margin = kernel.window // 2 + gaussian_reach(kernel.metric_scale)
    atlas = build_atlas(surface, [(image.shape[1], image.shape[0])], margin, 1)
    table, values = (part.reshape(-1, part.shape[2]).astype(np.float32) for part in (image, guide))
    guides = [Guide("guide", values[atlas.owned_texels], beta, in_chart_frame)]
    flow = texel_plan(atlas, table[atlas.owned_texels], kernel, guides=guides)
    new = table.copy()
    new[atlas.owned_texels] = smoothed(flow)
    return new.reshape(image.shape)


TURNED = [(1, 1, 1, False), (0, 0, 2, False), (0, 1, 3, False), (1, 0, 1, False)]


def test_guides_reach_over_seams_as_the_colours_do():
    board = Board(cells=8, texels=6, block=4, slot=32, slots=2, places=TURNED)
    whole = Board(8, 6, 8, SIDE, 1, [(0, 0, 0, False)])
    picture, guide = phantom(SIDE, 3), phantom(SIDE, 2)
    cut = with_guide(board.surface(), board.image_of(picture), board.image_of(guide))
    truth = with_guide(whole.surface(), picture, guide)
    # The same arithmetic in another order, see the same test of colours.
    assert np.abs(cut[board.texel_places()] - truth).max() < 2e-5


def test_frames_of_charts_that_meet_at_a_seam_are_no_edge():
    """A normal map of a tilted plane has another constant in every chart that is turned."""
    board = Board(cells=8, texels=6, block=4, slot=32, slots=2, places=TURNED)
    normal = np.empty((SIDE, SIDE, 3))
    for number, (_, _, turns, _) in enumerate(TURNED):
        row, column = divmod(number, 2)
        angle = turns * np.pi / 2
        part = np.s_[24 * row : 24 * row + 24, 24 * column : 24 * column + 24]
        normal[part] = 0.5 + 0.5 * np.array([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.75**0.5])
    picture = 0.5 + np.random.default_rng(3).normal(0, 20 / 255, (SIDE, SIDE, 1))
    surface, image = board.surface(), board.image_of(picture)
    flat = with_guide(surface, image, np.full((board.size, board.size, 3), 0.5))
    framed = with_guide(surface, image, board.image_of(normal), beta=50.0, in_chart_frame=True)
    stopped = with_guide(surface, image, board.image_of(normal), beta=50.0)
    places = board.texel_places()
    assert np.array_equal(framed[places], flat[places])
    assert np.abs(stopped[places] - flat[places]).max() > 0.01
