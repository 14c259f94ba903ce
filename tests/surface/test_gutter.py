"""Gutters take the nearest covered colour, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from beltrami_cli import _native
from beltrami_cli.surface import lookup
from beltrami_cli.surface.lookup import fill_gutter


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
    filled = filled_gutter(pixels, covered, None, 3)
    distance, (rows, columns) = ndimage.distance_transform_edt(~covered, return_indices=True)
    assert filled.dtype == pixels.dtype
    assert np.array_equal(filled[distance <= 3], pixels[rows, columns][distance <= 3])
    assert np.array_equal(filled[distance > 3], pixels[distance > 3])


def test_without_a_width_all_texels_with_content_are_filled(picture):
    pixels, covered = picture
    content = np.zeros_like(covered)
    content[:, :25] = True
    filled = filled_gutter(pixels, covered, content, None)
    assert np.array_equal(filled[:, 25:], pixels[:, 25:])
    assert np.array_equal(filled[0, 0], pixels[10, 5])
    assert np.array_equal(filled[29, 24], pixels[19, 14])


def test_known_texels_keep_their_colours_and_lend_none(picture):
    pixels, covered = picture
    known = np.zeros_like(covered)
    known[10:20, 15] = True
    filled = filled_gutter(pixels, covered, None, 4, known)
    assert np.array_equal(filled[known], pixels[known])
    assert np.array_equal(filled[12, 16], pixels[12, 14])


def test_nothing_covered_or_nothing_wanted_changes_nothing(picture):
    pixels, covered = picture
    assert np.array_equal(filled_gutter(pixels, np.zeros_like(covered), None, None), pixels)
    assert np.array_equal(filled_gutter(pixels, covered, None, 0), pixels)


@pytest.mark.parametrize("width", [3, 40])
def test_bands_of_rows_give_what_the_whole_gives(width, monkeypatch):
    random = np.random.default_rng(7)
    pixels = random.integers(0, 256, (90, 40, 3), dtype=np.uint8)
    covered = random.random((90, 40)) > 0.97
    whole = filled_gutter(pixels, covered, None, width, channels=[0, 2])
    assert np.array_equal(whole[..., 1], pixels[..., 1])
    assert not np.array_equal(whole, pixels)
    monkeypatch.setattr(lookup, "ROWS", 1)
    assert np.array_equal(filled_gutter(pixels, covered, None, width, channels=[0, 2]), whole)
