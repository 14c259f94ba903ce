"""Noise that differs from place to place, as of two photographs in one image."""

from __future__ import annotations

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow import grid_manifold
from beltrami_cli.flow.noise.by_place import find_relative_noise, louder_blocks
from oracles.paintings import flat_paint, line_art, photograph, psnr

SIZE, QUIET, LOUD = 256, 5 / 255, 20 / 255


def sigma_at_rows():
    """Return the standard deviation of rows: the lower half is louder."""
    return np.where(np.arange(SIZE) < SIZE // 2, QUIET, LOUD)[:, None, None]


def of_two_photographs(seed=0):
    """Return a picture, and the same with noise."""
    clean = photograph(SIZE)
    noise = sigma_at_rows() * np.random.default_rng(seed).standard_normal(clean.shape)
    return clean, np.clip(clean + noise, 0, 1).astype(np.float32)


def relative(image):
    planes = np.ascontiguousarray(np.moveaxis(image, 2, 0), np.float32)
    return find_relative_noise(planes, np.ones(planes.shape[1:], bool))


def test_the_noise_of_both_halves_is_found():
    """Within 20 % of its standard deviation, but for a tile on both sides of where it changes."""
    found, growth, most = relative(of_two_photographs()[1])
    assert QUIET < most < 3 * QUIET
    true = sigma_at_rows()[:, 0] / np.sqrt(np.mean(sigma_at_rows() ** 2))
    away = np.abs(np.arange(SIZE) - SIZE / 2) > 8
    ratio = np.median(np.sqrt(found), axis=1, keepdims=True) / true
    assert ratio[away] == pytest.approx(1, rel=0.2)
    assert growth == pytest.approx(np.sqrt(np.mean(sigma_at_rows() ** 2)) / QUIET, rel=0.2)
    assert found.mean() == pytest.approx(1, rel=1e-3)


def test_the_noise_of_both_halves_is_found_where_one_of_them_is_mostly_black():
    """Half of the noise of black is cut off; what is left shows how strong it was, within a third."""
    clean = photograph(SIZE)
    clean[SIZE // 2 :] *= (np.arange(SIZE) > SIZE * 3 // 4)[:, None]
    noise = sigma_at_rows() * np.random.default_rng(0).standard_normal(clean.shape)
    found = np.sqrt(relative(np.clip(clean + noise, 0, 1).astype(np.float32))[0])
    black = np.median(found[SIZE // 2 + 8 :, : SIZE * 3 // 4 - 8])
    assert black / np.median(found[: SIZE // 2 - 8]) == pytest.approx(LOUD / QUIET, rel=1 / 3)


def test_the_noise_of_both_halves_is_found_in_one_channel():
    """Within 20 % in the loud half; textures of one channel make the quiet one louder."""
    noise = sigma_at_rows() * np.random.default_rng(0).standard_normal((SIZE, SIZE, 1))
    found, *_ = relative(np.clip(photograph(SIZE, contrast=0.05)[..., :1] + noise, 0, 1))
    below = np.sqrt(np.median(found[: SIZE // 2 - 8])), np.sqrt(np.median(found[SIZE // 2 + 8 :]))
    assert below[1] == pytest.approx(LOUD / np.sqrt((QUIET**2 + LOUD**2) / 2), rel=0.2)
    assert below[0] < 0.6 * below[1]


@pytest.mark.parametrize(("scene", "sigma"), [(photograph, 5), (flat_paint, 20), (line_art, 0)])
def test_even_noise_of_one_channel_is_the_same_everywhere(scene, sigma):
    clean = scene(SIZE)[..., :1]
    noisy = clean + sigma / 255 * np.random.default_rng(1).standard_normal(clean.shape)
    assert relative(np.clip(noisy, 0, 1).astype(np.float32)) is None


@pytest.mark.parametrize("sigma", [0, 20])
def test_textures_and_even_noise_are_the_same_everywhere(sigma):
    clean = photograph(SIZE)
    noisy = clean + sigma / 255 * np.random.default_rng(1).standard_normal(clean.shape)
    assert relative(np.clip(noisy, 0, 1).astype(np.float32)) is None


def test_what_blocks_of_like_levels_share_and_some_texture_are_no_places():
    """Noise grows towards the dark by 1.7, texture adds up to a factor of 1.6: each alone is not enough."""
    down, across = np.mgrid[:8, :8].reshape(2, -1) / 7
    variances = 2e-4 * 1.7 ** (2 * (1 - across)) * 1.6 ** (2 * down)
    tiles = np.broadcast_to(variances.astype(np.float32)[:, None], (2, 3, 64, 16))
    assert louder_blocks(tiles, across.astype(np.float32)) is None
    twice = np.where(down > 0.5, 4 * variances, variances).astype(np.float32)
    tiles = np.broadcast_to(twice[:, None], (2, 3, 64, 16))
    assert louder_blocks(tiles, across.astype(np.float32)) is not None


def test_blocks_with_uneven_tiles_here_and_there_are_texture():
    """Tiles of noise have 48 details: the upper quartile is 1.3 times the energy of even ones, of texture 2."""
    loud = np.where(np.arange(64) % 5 == 0, 6.0, 1.0)[:, None] * np.ones(16)
    uneven = np.where(np.arange(16) < 8, 1.0, 2.0)
    for tiles, is_noise in ((loud, True), (np.where(loud > 1, loud * uneven, loud), False)):
        tiles = np.broadcast_to(2e-4 * tiles.astype(np.float32), (2, 3, 64, 16))
        assert (louder_blocks(tiles, np.full(64, 0.5, np.float32)) is not None) == is_noise


@pytest.mark.slow
def test_both_halves_are_smoothed_as_their_noise_asks():
    """Nearly as each half by itself; by one noise for both, most of the noise of the louder half stays."""
    clean, noisy = of_two_photographs()
    half = SIZE // 2
    alone = [beltrami_cli.smooth_image(part).colours for part in (noisy[:half], noisy[half:])]
    together = beltrami_cli.smooth_image(noisy).colours
    assert psnr(together, clean) > psnr(np.concatenate(alone), clean) - 3
    assert psnr(together[half:], clean[half:]) > psnr(noisy[half:], clean[half:]) + 4


@pytest.mark.slow
def test_blocks_of_rows_give_the_same(monkeypatch):
    noisy = of_two_photographs()[1]
    whole = beltrami_cli.smooth_image(noisy, fast=True).colours
    monkeypatch.setattr(grid_manifold, "ROW_BLOCK_CELLS", 1)
    monkeypatch.setattr(grid_manifold, "CELLS_PER_THREAD", 1)
    assert np.array_equal(beltrami_cli.smooth_image(noisy, fast=True).colours, whole)
