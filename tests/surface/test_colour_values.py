"""The sRGB transfer function and its inverse agree; numbers are rounded as exact arithmetic says."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.surface.colour_map import VIRIDIS, colour_by_value
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear, store_integers

values = st.floats(-8.0, 8.0, allow_nan=False)


def test_known_values_of_the_standard():
    srgb = np.array([0.0, 0.02, 0.5, 188 / 255, 1.0])
    linear = np.array([0.0, 0.02 / 12.92, 0.21404114048223255, 0.5028864580325687, 1.0])
    np.testing.assert_allclose(srgb_to_linear(srgb), linear, rtol=1e-12)


@given(values, values)
def test_both_functions_keep_signs_and_order_and_undo_each_other(one, other):
    low, high = min(one, other), max(one, other)
    assert srgb_to_linear(low) <= srgb_to_linear(high)
    # The standard rounds its constants: at the knees the two pieces miss each other by about 3e-8.
    assert linear_to_srgb(low) <= linear_to_srgb(high) + 1e-6
    for there, back in ((srgb_to_linear, linear_to_srgb), (linear_to_srgb, srgb_to_linear)):
        assert there(-one) == -there(one)
        assert back(there(one)) == pytest.approx(one, rel=1e-12, abs=1e-6)


def test_float32_stays_float32_and_shape_stays():
    block = np.linspace(-1, 2, 12, dtype=np.float32).reshape(2, 3, 2)
    assert srgb_to_linear(block).dtype == np.float32
    assert linear_to_srgb(block).shape == block.shape
    assert srgb_to_linear([0, 1]).dtype == np.float64


def nearest(value, most):
    """The integer nearest to value * most, the even of two, by rational numbers."""
    return round(Fraction(float(np.float32(min(max(value, 0), 1)))) * most)


@pytest.mark.slow
@given(
    st.sampled_from([np.uint8, np.uint16]),
    st.sampled_from([np.int32, np.int64]),
    st.sampled_from([[3, 0], [0, 1, 2, 3], [0, 1, 3, 2]]),
    st.lists(st.floats(-0.5, 1.5, width=32) | st.sampled_from([0.5, 0.1, np.inf, -np.inf]), max_size=80),
    st.booleans(),
    st.integers(1, 3),
)
@settings(max_examples=200, deadline=None)
def test_each_number_is_rounded_once_and_no_other_changes(kind, index, channels, numbers, in_runs, threads):
    most, width = int(np.iinfo(kind).max), len(channels)
    values = np.array(numbers[: len(numbers) // width * width], np.float32).reshape(-1, width)
    random = np.random.default_rng(len(numbers))
    table = random.integers(0, most + 1, (50, 4)).astype(kind)
    pixels = random.permutation(50)[: len(values)].astype(index)
    if in_runs:
        pixels.sort()
    expected = table.astype(int)
    for pixel, row in zip(pixels, values, strict=True):
        expected[pixel, channels] = [nearest(value, most) for value in row]
    step = np.abs(expected - table)
    found = store_integers(table, pixels, values, channels, threads)
    assert np.array_equal(table, expected)
    # Sums of integers are exact, so only their quotients are rounded.
    scale = np.array([most, most**2, most])
    sums = np.array([step.sum(), np.square(step).sum(), step.max()])
    assert found == pytest.approx(sums / scale, rel=1e-15)


def test_the_largest_changes_of_many_numbers_in_one_run_are_summed_exactly():
    for kind in (np.uint8, np.uint16):
        most = int(np.iinfo(kind).max)
        table, black = np.full((100_000, 3), most, kind), np.zeros((100_000, 3), np.float32)
        found = store_integers(table, np.arange(100_000), black, [0, 1, 2], 2)
        assert tuple(found) == (300_000, 300_000, 1)


def test_what_is_no_number_becomes_0():
    table = np.full((2, 1), 7, np.uint8)
    store_integers(table, np.array([1]), np.array([[np.nan]], np.float32), [0], 1)
    assert table.tolist() == [[7], [0]]


@pytest.mark.parametrize(("pixels", "channels"), [([2], [0]), ([-1], [0]), ([0], [3]), ([0], [-1])])
def test_what_is_not_there_is_refused(pixels, channels):
    table, colour = np.zeros((2, 3), np.uint8), np.zeros((1, 1), np.float32)
    with pytest.raises(IndexError):
        store_integers(table, np.array(pixels), colour, channels, 1)


def test_without_a_value_the_grey_of_the_colours_shows():
    values = np.array([0.0, 0.5, 1.0, 0.0, 0.5, 1.0], np.float32)
    colours = np.repeat(np.float32([0, 0.3, 0.6, 0.6, 0.3, 1]), 3).reshape(-1, 3)
    known = np.arange(6) < 3
    shown = colour_by_value(values, colours, known)
    np.testing.assert_allclose(shown[known], VIRIDIS[[0, 5, 10]])
    assert (np.ptp(shown[~known], axis=1) == 0).all()
    assert (np.argsort(shown[~known, 0]) == np.argsort(colours[~known, 0])).all()
