"""Lookups agree with a renderer; gutters take the nearest covered colour, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from beltrami_cli import _native
from beltrami_cli.surface import atlas
from beltrami_cli.surface.atlas import fill_gutter
from beltrami_cli.surface.baking import look_up, noise_around

CLAMP = ("clamp", "clamp")


@pytest.mark.parametrize("wrap", [CLAMP, ("repeat", "repeat"), ("mirror", "mirror"), ("repeat", "clamp")])
def test_lookups_beyond_the_image_follow_the_wrap_mode(wrap):
    random = np.random.default_rng(1)
    image = random.random((5, 7, 2)).astype(np.float32)
    modes = {"clamp": "edge", "repeat": "wrap", "mirror": "symmetric"}
    padded = np.pad(image, ((15, 15), (0, 0), (0, 0)), modes[wrap[1]])
    padded = np.pad(padded, ((0, 0), (21, 21), (0, 0)), modes[wrap[0]])
    uv = random.uniform(-2.4, 3.4, (500, 2))
    repeated = (uv + 3) / 7  # the same place in the image that is continued
    assert np.allclose(look_up(image, uv, wrap), look_up(padded, repeated, CLAMP), atol=1e-6)


def test_a_lookup_at_a_centre_gives_that_texel():
    image = np.random.default_rng(2).random((4, 6, 3)).astype(np.float32)
    y, x = np.mgrid[:4, :6]
    uv = np.stack([(x + 0.5) / 6, (y + 0.5) / 4], axis=-1).reshape(-1, 2)
    assert np.allclose(look_up(image, uv, CLAMP).reshape(image.shape), image, atol=1e-6)


def test_invisible_texels_lend_no_colour():
    image = np.array([[[0.2, 0.4, 0.6, 1.0], [9.0, 9.0, 9.0, 0.0]]], np.float32)
    halfway = look_up(image, np.array([[0.5, 0.5]]), CLAMP, alpha=3)[0]
    assert np.allclose(halfway, [0.2, 0.4, 0.6, 0.5])


def test_noise_is_found_and_planes_have_none():
    y, x = np.mgrid[:64, :64] / 64
    plane = np.stack([x, y, x + y], axis=-1).astype(np.float32)
    uv = np.random.default_rng(3).uniform(0.1, 0.9, (2000, 2))
    assert np.abs(noise_around(plane, uv, CLAMP)).max() < 1e-5
    noisy = plane + np.random.default_rng(4).normal(0, 0.05, plane.shape).astype(np.float32)
    assert noise_around(noisy, uv, CLAMP).std() == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40), st.floats(0.001, 1), st.floats(0.01, 1),
    st.integers(0, 80),
)  # fmt: skip
@settings(max_examples=300, deadline=None)
def test_the_nearest_mark_is_the_nearest(seed, height, width, density, wish, reach):
    random = np.random.default_rng(seed)
    marked, wanted = random.random((height, width)) < density, random.random((height, width)) < wish
    texels, marks = _native.nearest_marked(marked, wanted, reach, 2)
    distance = ndimage.distance_transform_edt(~marked) if marked.any() else np.full(marked.shape, np.inf)
    assert np.array_equal(texels, np.flatnonzero(wanted & (distance <= reach)))
    assert marked.ravel()[marks].all()
    (y, x), (rows, columns) = np.divmod(texels, width), np.divmod(marks, width)
    assert np.array_equal((rows - y) ** 2 + (columns - x) ** 2, np.rint(distance.ravel()[texels] ** 2))


def filled_gutter(pixels, *arguments, **options):
    filled = pixels.copy()
    fill_gutter(filled, *arguments, **options)
    return filled


@pytest.fixture
def picture():
    pixels = np.random.default_rng(3).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    covered = np.zeros((30, 40), bool)
    covered[10:20, 5:15] = True
    return pixels, covered


def test_only_texels_within_the_width_are_filled(picture):
    pixels, covered = picture
    filled = filled_gutter(pixels, covered, 3)
    distance, (rows, columns) = ndimage.distance_transform_edt(~covered, return_indices=True)
    assert filled.dtype == pixels.dtype
    assert np.array_equal(filled[distance <= 3], pixels[rows, columns][distance <= 3])
    assert np.array_equal(filled[distance > 3], pixels[distance > 3])


def test_without_a_width_all_texels_are_filled_whatever_is_not_known(picture):
    pixels, covered = picture
    known = np.ones_like(covered)
    known[:, :25] = False
    filled = filled_gutter(pixels, covered, None, known)
    assert np.array_equal(filled[:, 25:], pixels[:, 25:])
    assert np.array_equal(filled[0, 0], pixels[10, 5])
    assert np.array_equal(filled[29, 24], pixels[19, 14])


def test_known_texels_keep_their_colours_and_lend_none(picture):
    pixels, covered = picture
    known = np.zeros_like(covered)
    known[10:20, 15] = True
    filled = filled_gutter(pixels, covered, 4, known)
    assert np.array_equal(filled[known], pixels[known])
    assert np.array_equal(filled[12, 16], pixels[12, 14])


def test_nothing_covered_or_nothing_wanted_changes_nothing(picture):
    pixels, covered = picture
    assert np.array_equal(filled_gutter(pixels, np.zeros_like(covered), None), pixels)
    assert np.array_equal(filled_gutter(pixels, covered, 0), pixels)


@pytest.mark.parametrize("width", [3, 40])
def test_bands_of_rows_give_what_the_whole_gives(width, monkeypatch):
    random = np.random.default_rng(7)
    pixels = random.integers(0, 256, (90, 40, 3), dtype=np.uint8)
    covered = random.random((90, 40)) > 0.97
    whole = filled_gutter(pixels, covered, width, channels=[0, 2])
    assert np.array_equal(whole[..., 1], pixels[..., 1])
    assert not np.array_equal(whole, pixels)
    monkeypatch.setattr(atlas, "ROWS", 1)
    assert np.array_equal(filled_gutter(pixels, covered, width, channels=[0, 2]), whole)
