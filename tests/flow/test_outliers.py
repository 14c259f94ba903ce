"""Samples that are wrong one by one are replaced, on all surfaces by one rule; what is thin but real stays."""

import dataclasses

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunking, Resources, in_turn
from beltrami_cli.flow.corrections.outliers import fill_outliers
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.manifolds.grid.surroundings import CanvasSurroundings
from beltrami_cli.flow.parameters import KernelParameters, parameters_from
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.surface.grid_atlas import grid_atlas
from oracles import surfaces
from properties.textured_planes import Board, smooth_image, smoothed

SIDE = 128
PLAIN = KernelParameters(threads=1)


def gradient(side=SIDE):
    """A slow gradient with a soft spot and a step, in 8 bits."""
    y, x = np.mgrid[:side, :side] / side
    grey = 0.85 - 0.3 * y - 0.35 * (x + y > 1.2) - 0.3 * np.exp(-((x - 0.3) ** 2 + (y - 0.6) ** 2) / 0.01)
    return np.rint(255 * grey[..., None] * [1, 0.95, 0.85]).astype(np.uint8)


def salted(colours, share=0.02, seed=1, value=None):
    """Make a share of rows black or white, or of one value; return them with where."""
    rng = np.random.default_rng(seed)
    where = rng.random(colours.shape[:-1]) < share
    new = colours.copy()
    new[where] = (255 * (rng.random(where.sum()) < 0.5))[:, None] if value is None else value
    return new, where


def error(colours, truth):
    return np.sqrt(np.mean((np.asarray(colours, float) - truth) ** 2))


def found_in(image, mode="auto", *, is_light=False):
    """Return the outliers of an image with colours from 0 to 1, and its colours without them."""
    image = image[..., None] if image.ndim == 2 else image
    atlas = grid_atlas(image.shape[:2], 2, None, np.ones(image.shape[:2], bool))
    planes = np.zeros((image.shape[2], *atlas.kind.shape), np.float32)
    planes[:, 2:-2, 2:-2] = np.moveaxis(image, 2, 0)
    parameters = KernelParameters(threads=1, outliers=mode)
    filled, outliers = fill_outliers(planes, CanvasSurroundings(atlas), parameters, is_light=is_light)
    return outliers, np.moveaxis(filled[:, 2:-2, 2:-2], 0, 2)


@pytest.mark.parametrize("value", [None, (220, 20, 20)])
@pytest.mark.parametrize("share", [0.02, 0.1])
def test_wrong_pixels_of_one_value_are_replaced_and_all_others_keep_their_bits(share, value):
    truth = gradient()
    image, where = salted(truth, share, value=value)
    result = beltrami_cli.smooth_image(image, threads=1)
    assert 0.98 * where.sum() <= result.wrong_samples["count"] <= where.sum()
    assert result.wrong_samples["replaced"]
    assert error(result.colours, truth) < 0.1 * error(image, truth)
    assert np.array_equal(result.colours[~where], image[~where])


def test_noise_is_read_and_removed_as_if_they_had_not_been_there():
    truth = gradient()
    noisy = np.clip(truth + np.random.default_rng(2).normal(0, 10, truth.shape), 0, 255)
    noisy = np.rint(noisy).astype(np.uint8)
    with_outliers, without = (
        beltrami_cli.smooth_image(image, threads=1, fast=True) for image in (salted(noisy, 0.05)[0], noisy)
    )
    assert with_outliers.noise == pytest.approx(without.noise, rel=0.1)
    assert error(with_outliers.colours, truth) < 1.2 * error(without.colours, truth)


@pytest.mark.parametrize("kind", ["mesh", "cloud"])
def test_wrong_vertices_and_points_are_replaced(kind):
    positions, faces = surfaces.icosphere(4)
    truth = 0.5 + 0.3 * np.sin(3 * positions + [0, 1, 2])
    truth = np.rint(255 * truth).astype(np.uint8)
    colours, where = salted(truth, 0.05)
    result = beltrami_cli.smooth(positions, faces if kind == "mesh" else None, colours, threads=1)
    assert result.wrong_samples["count"] >= 0.98 * where.sum()
    assert error(result.colours, truth) < 0.1 * error(colours, truth)
    assert np.array_equal(result.colours[~where], colours[~where])


def test_fireflies_of_light_are_replaced_and_its_mean_stays_without_them():
    rng = np.random.default_rng(3)
    truth = np.broadcast_to(0.2 + gradient()[..., :1] / 255.0, (SIDE, SIDE, 3))
    light = (truth * np.exp(rng.normal(-0.03, 0.25, (SIDE, SIDE, 1)))).astype(np.float32)
    where = rng.random((SIDE, SIDE)) < 0.005
    image = light.copy()
    image[where] *= rng.uniform(20, 200, (where.sum(), 1))
    result = beltrami_cli.smooth_image(image, encoding="linear", threads=1, fast=True)
    assert result.wrong_samples["count"] == pytest.approx(where.sum(), rel=0.2)
    assert result.colours[where] == pytest.approx(truth[where], rel=0.3)
    assert result.colours.mean() == pytest.approx(light[~where].mean(), rel=0.01)


@pytest.mark.parametrize("shape", [0.25, 1.0])
def test_the_long_tail_of_light_stays(shape):
    light = (
        0.2 + np.random.default_rng(4).gamma(shape, 1 / shape, (SIDE, SIDE, 1)) * gradient()[..., :1] / 255.0
    )
    assert found_in(light.astype(np.float32), is_light=True)[0] is None


def test_only_the_channel_that_is_wrong_changes():
    image = np.concatenate([gradient(), gradient()[:, ::-1, :2]], axis=2)
    image[..., 4:], where = salted(image[..., 4:], 0.03)
    outliers, new = found_in((image / 255).astype(np.float32))
    assert np.array_equal(outliers.channels, np.tile([False] * 4 + [True], (where.sum(), 1)))
    assert np.array_equal(outliers.samples, np.flatnonzero(where))
    assert np.array_equal(new[..., :4], (image / 255).astype(np.float32)[..., :4])


def test_clumps_that_resampling_leaves_are_replaced():
    truth = gradient(64).repeat(2, axis=0).repeat(2, axis=1)
    image, where = gradient(64), np.zeros((64, 64), bool)
    image[::2, ::2], where[::2, ::2] = salted(image[::2, ::2], 0.06)  # clumps that do not touch
    image, where = image.repeat(2, axis=0).repeat(2, axis=1), where.repeat(2, axis=0).repeat(2, axis=1)
    result = beltrami_cli.smooth_image(image, threads=1)
    assert result.wrong_samples["count"] == where.sum()
    assert error(result.colours, truth) < 0.1 * error(image, truth)


def stars():
    rng = np.random.default_rng(5)
    image = np.full((SIDE, SIDE, 3), 8.0) + np.linspace(0, 10, SIDE)[:, None, None]
    where = rng.random((SIDE, SIDE)) < 0.01
    image[where] = rng.uniform(60, 255, (where.sum(), 1))
    return image


def rivets():
    image = gradient().astype(float)
    image[4::8, 4::8] = 255
    return image


def highlights():
    rng, image = np.random.default_rng(6), np.full((SIDE, SIDE, 3), [60.0, 90, 60])
    y, x = np.mgrid[:SIDE, :SIDE]
    for _ in range(60):
        row, column = rng.integers(8, SIDE - 8, 2)
        image[(y - row) ** 2 + (x - column) ** 2 < 30] = rng.integers(20, 200, 3)
        image[row - 2, column - 2] = 255
    return image


def error_diffusion():
    grey, image = 0.8 + 0.2 * gradient()[..., 0] / 255.0, np.zeros((SIDE, SIDE))
    for row in range(SIDE - 1):
        for column in range(1, SIDE - 1):
            image[row, column] = grey[row, column] > 0.5
            rest = grey[row, column] - image[row, column]
            grey[row, column + 1] += rest * 7 / 16
            grey[row + 1, column - 1 : column + 2] += rest * np.array([3, 5, 1]) / 16
    return 255 * image[:-1, 1:-1]


def halftone():
    y, x = np.mgrid[:SIDE, :SIDE]
    screen = 0.5 + 0.25 * (np.cos(np.pi * (x + y) / 4.3) + np.cos(np.pi * (x - y) / 4.3))
    return 255.0 * (0.75 + 0.25 * gradient()[..., 0] / 255 > screen)


def dashed_lines():
    rng, image = np.random.default_rng(7), gradient().astype(float)
    for row in rng.integers(0, SIDE, 30):
        image[row, rng.random(SIDE) < 0.7] = 10
    return image


def scattered_points():
    rng, image = np.random.default_rng(8), np.full((SIDE, SIDE, 3), 255.0)
    image[rng.random((SIDE, SIDE)) < 0.01] = [30, 60, 200]
    return image


def few_dead_looking_texels():
    image = gradient().astype(float)
    image[np.random.default_rng(9).random((SIDE, SIDE)) < 0.0006] = 255
    return image


THIN = [
    stars,
    rivets,
    highlights,
    error_diffusion,
    halftone,
    dashed_lines,
    scattered_points,
    few_dead_looking_texels,
]


@pytest.mark.parametrize("draw", THIN)
def test_what_is_thin_but_real_stays(draw):
    image = (draw() / 255).astype(np.float32)
    outliers, new = found_in(image)
    assert outliers is None
    assert np.array_equal(new.reshape(image.shape), image)


def test_replace_takes_what_stands_out_however_it_is_spread():
    image = (rivets() / 255).astype(np.float32)
    outliers, new = found_in(image, "replace")
    assert len(outliers.samples) == (SIDE // 8) ** 2
    assert np.abs(new - gradient() / 255).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("fast", [False, True])
def test_kept_outliers_keep_their_bits_and_do_not_change_the_others(fast):
    noisy = gradient() + np.random.default_rng(2).normal(0, 8, (SIDE, SIDE, 3))
    image, where = salted(np.rint(np.clip(noisy, 0, 255)).astype(np.uint8))
    kept, replaced = (
        beltrami_cli.smooth_image(image, threads=1, fast=fast, outliers=mode) for mode in ("keep", "auto")
    )
    assert not kept.wrong_samples["replaced"]
    assert np.array_equal(kept.colours[where], image[where])
    assert np.array_equal(kept.colours[~where], replaced.colours[~where])


def test_kept_vertices_keep_their_bits():
    positions, faces = surfaces.icosphere(4)
    truth = 0.5 + 0.3 * np.sin(3 * positions) + np.random.default_rng(1).normal(0, 0.04, positions.shape)
    colours, where = salted(np.rint(255 * truth).astype(np.uint8), 0.05)
    result = beltrami_cli.smooth(positions, faces, colours, threads=1, fast=True, outliers="keep")
    assert result.wrong_samples["count"] >= 0.98 * where.sum()
    changed = (result.colours != colours).any(axis=1)
    assert np.count_nonzero(changed & where) < 0.02 * where.sum() + 1
    assert np.count_nonzero(changed) > 0.9 * np.count_nonzero(~where)


def test_outliers_are_found_across_seams():
    places = [(0, 0, 0, False), (0, 1, 1, False), (1, 0, 2, True), (1, 1, 3, False)]
    board = Board(cells=4, texels=24, block=2, slot=64, slots=2, places=places)
    truth = (gradient(96) / 255.0).astype(np.float32)
    phantom, where = salted(truth, 0.03)
    phantom[where] /= 255
    y, x = board.texel_places()
    new, plan = smooth_image(board.surface(), board.image_of(phantom), iterations=1, beta=1e6)
    assert plan.outliers["count"] == where.sum()
    away = np.abs(new[y, x] - truth)[where]
    assert np.median(away) < 0.02
    beside_seams = where.copy()
    beside_seams[:] = False
    beside_seams[:, 47:49] = beside_seams[47:49] = True
    assert np.abs(new[y, x] - truth)[where & beside_seams].max() < 0.1


@pytest.mark.slow
def test_the_result_does_not_depend_on_threads_and_chunks():
    noisy = gradient() + np.random.default_rng(2).normal(0, 8, (SIDE, SIDE, 3))
    image, _ = salted(np.rint(np.clip(noisy, 0, 255)).astype(np.uint8), 0.05)
    one = beltrami_cli.smooth_image(image, threads=1)
    assert np.array_equal(one.colours, beltrami_cli.smooth_image(image, threads=3).colours)
    canvas = canvas_of_image(
        ImageSurface(valid=np.ones((SIDE, SIDE), bool)),
        (image.reshape(-1, 3) / np.float32(255)).__getitem__,
        parameters_from({"threads": 1}),
    )
    whole, parts = (
        smoothed(plan_on_canvas(dataclasses.replace(canvas, resources=resources)))
        for resources in (IN_ONE_PIECE, Resources(Chunking(3, in_turn)))
    )
    assert np.array_equal(whole, parts)


def test_no_iterations_leave_every_bit():
    image, _ = salted(gradient())
    result = beltrami_cli.smooth_image(image, iterations=0)
    assert np.array_equal(result.colours, image)
    assert not result.wrong_samples
