"""`beltrami_cli.smooth` takes arrays that fit, and refuses all others with one line."""

from __future__ import annotations

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.errors import InputError, UsageError

POSITIONS = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
FACES = [[0, 1, 2], [1, 3, 2]]
COLOURS = np.array([[0, 10, 20], [30, 40, 50], [60, 70, 80], [255, 255, 255]], np.uint8)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"faces": [[0, 1, 2, 3]] * 3}, r"shape \(F, 3\)"),
        ({"faces": [0, 1, 2]}, r"shape \(F, 3\)"),
        ({"faces": [[0, 1, 2**32 + 2]]}, "face 0 is .* 4 vertices"),
        ({"faces": [[0, 1, 2], [0, 1, 4]]}, "face 1 is"),
        ({"faces": [[0, 1, -1]]}, "face 0 is"),
        ({"faces": [[0, 1, 2**70]]}, "whole numbers"),
        ({"faces": [[0, 1, 2.5]]}, "whole numbers"),
        ({"faces": [[0, 1, 2], [1, 3]]}, "same length"),
        ({"faces": [[True, False, True]]}, "whole numbers"),
        ({"positions": [[0.0, 1], [2]]}, "same length"),
        ({"positions": [["a", "b", "c"]] * 4}, "positions must be numbers"),
        ({"positions": [0.0, 1, 2, 3]}, r"shape \(V, M\)"),
        ({"positions": np.zeros((4, 3), complex)}, "positions must be numbers"),
        ({"positions": np.zeros((4, 0))}, r"shape \(V, M\)"),
        ({"colours": COLOURS.tolist()}, "uint8"),
        ({"colours": COLOURS.astype(np.int16)}, "uint8"),
        ({"colours": COLOURS.astype(np.uint64)}, "uint8"),
        ({"colours": COLOURS > 50}, "colours must be numbers"),
        ({"colours": np.zeros((4, 0))}, r"shape \(V, C\)"),
        ({"colours": [[0.1], [0.2, 0.3]]}, "same length"),
        ({"encoding": "foo"}, "encoding is foo"),
        ({"iterations": 2.5}, "iterations is 2.5"),
    ],
)
def test_arrays_and_parameters_that_do_not_fit_are_refused_by_one_line(change, said):
    arguments = {"positions": POSITIONS, "faces": FACES, "colours": COLOURS, **change}
    with pytest.raises(UsageError, match=said) as caught:
        beltrami_cli.smooth(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("change", [{"colours": COLOURS[:3]}, {"colours": np.full((4, 3), 1e300)}])
def test_colours_that_are_too_few_or_not_finite_are_refused(change):
    with pytest.raises(InputError):
        beltrami_cli.smooth(**{"positions": POSITIONS, "faces": FACES, "colours": COLOURS, **change})


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
def test_integer_colours_are_taken_by_the_full_scale_of_their_type(kind):
    scale = np.iinfo(kind).max // 255
    scaled = COLOURS.astype(kind) * kind(scale)
    result = beltrami_cli.smooth(POSITIONS, FACES, scaled, beta=3, iterations=2)
    floats = beltrami_cli.smooth(POSITIONS, FACES, COLOURS / 255, beta=3, iterations=2)
    assert np.allclose(result.colours, floats.colours, atol=1e-6)
    assert not np.allclose(floats.colours, COLOURS / 255, atol=1e-6)


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.uint16, np.int64, np.uint64])
def test_faces_may_be_of_any_integer_type(kind):
    expected = beltrami_cli.smooth(POSITIONS, FACES, COLOURS).colours
    assert np.array_equal(beltrami_cli.smooth(POSITIONS, np.array(FACES, kind), COLOURS).colours, expected)


def test_empty_arrays_give_empty_colours_and_no_warning():
    assert beltrami_cli.smooth([], [], []).colours.shape == (0, 3)
    assert beltrami_cli.smooth(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2))).colours.shape == (0, 2)
    lonely = beltrami_cli.smooth(POSITIONS, [], COLOURS)
    assert np.array_equal(lonely.colours, (COLOURS / 255).astype(np.float32))
