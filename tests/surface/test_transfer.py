"""The sRGB pair: what the standard says, and that the two undo each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

values = st.floats(-8.0, 8.0, allow_nan=False)


def test_known_values_of_the_standard() -> None:
    srgb = np.array([0.0, 0.02, 0.5, 188 / 255, 1.0])
    linear = np.array([0.0, 0.02 / 12.92, 0.21404114048223255, 0.5028864580325687, 1.0])
    np.testing.assert_allclose(srgb_to_linear(srgb), linear, rtol=1e-12)


@given(values)
def test_the_two_undo_each_other(value: float) -> None:
    # The standard rounds its constants: at the knees the two pieces miss each other by about 3e-8.
    assert linear_to_srgb(srgb_to_linear(value)) == pytest.approx(value, rel=1e-12, abs=1e-6)
    assert srgb_to_linear(linear_to_srgb(value)) == pytest.approx(value, rel=1e-12, abs=1e-6)


@given(values)
def test_odd_symmetry(value: float) -> None:
    assert srgb_to_linear(-value) == -srgb_to_linear(value)
    assert linear_to_srgb(-value) == -linear_to_srgb(value)


@given(values, values)
def test_order_is_kept(one: float, other: float) -> None:
    low, high = min(one, other), max(one, other)
    assert srgb_to_linear(low) <= srgb_to_linear(high)
    assert linear_to_srgb(low) <= linear_to_srgb(high) + 1e-6


def test_every_8_and_16_bit_value_returns_to_itself() -> None:
    for full in (255, 65535):
        stored = np.arange(full + 1)
        there = srgb_to_linear(stored / full)
        np.testing.assert_array_equal(np.rint(linear_to_srgb(there) * full), stored)


def test_float32_stays_float32_and_shape_stays() -> None:
    block = np.linspace(-1, 2, 12, dtype=np.float32).reshape(2, 3, 2)
    assert srgb_to_linear(block).dtype == np.float32
    assert linear_to_srgb(block).shape == block.shape
    assert srgb_to_linear([0, 1]).dtype == np.float64
