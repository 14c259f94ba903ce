"""Lengths of numbers whose squares are none."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.surface.geometry import unit_vectors


def test_vectors_whose_squares_are_beyond_all_numbers_have_a_direction():
    vectors = np.array([[3e200, 4e200, 0], [0, 0, 0], [3, 4, 0]])
    assert unit_vectors(vectors) == pytest.approx(np.array([[0.6, 0.8, 0], [0, 0, 0], [0.6, 0.8, 0]]))
