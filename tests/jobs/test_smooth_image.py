"""`beltrami_cli.smooth_image` takes arrays that fit, and refuses all others with one line."""

from unittest.mock import Mock

import numpy as np
import pytest

from beltrami_cli import smooth_image
from beltrami_cli.errors import UsageError
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

RANDOM = np.random.default_rng(0)
IMAGE = np.clip(0.4 + 0.3 * (np.arange(20) > 9)[:, None] + RANDOM.normal(0, 0.05, (14, 20, 3)), 0, 1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"colours": np.zeros((2, 3, 4, 5))}, r"\(H, W\) or"),
        ({"colours": np.zeros((0, 3))}, r"\(H, W\) or"), ({"colours": [[0, 255], [255, 0]]}, "uint8"),
        ({"surface": ImageSurface(positions=np.zeros((20, 14, 3)))}, r"positions .* of shape \(14, 20, M\)"),
        ({"surface": ImageSurface(heights=np.zeros((14, 20, 1)))}, r"heights .* of shape \(14, 20\)"),
        ({"surface": ImageSurface(heights=[["a"] * 20] * 14)}, "heights must be numbers"),
        ({"surface": ImageSurface(valid=np.ones((14, 19), bool))}, "valid must be numbers"),
        ({"surface": ImageSurface(valid=np.ones((14, 20)))}, "valid must be numbers"),
        ({"surface": ImageSurface(np.zeros((14, 20)), np.zeros((14, 20, 3)))}, "two surfaces"),
        ({"window": 6}, "window is 6"), ({"iterationss": 3}, "did you mean iterations"),
        ({"encoding": "gamma"}, "encoding is gamma"),
        ({"space": "oklab", "colours": IMAGE[..., :2]}, "three channels"),
    ],
)  # fmt: skip
def test_arrays_and_parameters_that_do_not_fit_are_refused_by_one_line(change, said):
    with pytest.raises(UsageError, match=said) as caught:
        smooth_image(**{"colours": IMAGE, **change})
    assert "\n" not in str(caught.value)


def test_an_image_of_one_channel_needs_no_axis_for_it():
    flat = smooth_image(IMAGE[..., 0], beta=5)
    assert flat.colours.shape == (14, 20, 1)
    np.testing.assert_array_equal(flat.colours, smooth_image(IMAGE[..., :1], beta=5).colours)


def test_heights_are_positions_over_the_pixels():
    y, x = np.mgrid[:14, :20]
    height = np.sin(x) + y / 5
    positions = np.dstack([x, y, 3 * height])
    over = smooth_image(IMAGE, surface=ImageSurface(heights=3 * height), beta=6)
    at = smooth_image(IMAGE, surface=ImageSurface(positions=positions), beta=6, units="world")
    np.testing.assert_array_equal(over.colours, at.colours)
    level = smooth_image(IMAGE, surface=ImageSurface(heights=0 * height), beta=6)
    np.testing.assert_array_equal(level.colours, smooth_image(IMAGE, beta=6).colours)


def test_what_is_not_finite_or_not_valid_is_a_hole_and_keeps_its_bits():
    image, height, valid = IMAGE.astype(np.float32), np.zeros((14, 20)), np.ones((14, 20), bool)
    image[2, 3, 1], image[5, 6] = np.nan, np.inf
    height[7, 8], valid[9, 10] = -np.inf, False
    result = smooth_image(image, surface=ImageSurface(heights=height, valid=valid), beta=5, iterations=1)
    holes = [(2, 3), (5, 6), (7, 8), (9, 10)]
    for place in holes:
        assert result.colours[place].tobytes() == image[place].tobytes()
    assert result.samples == image[..., 0].size - len(holes)
    others = np.ones((14, 20), bool)
    others[tuple(np.transpose(holes))] = False
    assert (result.colours != image).any(axis=2)[others].all()


def test_an_image_of_holes_only_comes_back():
    image = np.full((4, 5, 2), np.nan)
    result = smooth_image(image)
    assert np.isnan(result.colours).all()
    assert (result.samples, result.spacing) == (0, 0)


def test_the_space_is_where_averages_are_taken():
    """Exactly, but for beta: between units of light it is converted by a power, from which dark sRGB departs."""
    given = {"iterations": 2, "t": 2.4, "beta": 4, "beta_growth": 2, "metric_steps": 0, "clipping": "keep"}
    to_linear, to_srgb = ("linear", srgb_to_linear), ("srgb", linear_to_srgb)
    for (space, there), (encoding, back) in ((to_linear, to_srgb), (to_srgb, to_linear)):
        expected = back(smooth_image(there(IMAGE), space="data", **given).colours)
        found = smooth_image(IMAGE, space=space, encoding=encoding, **given).colours
        assert np.abs(found - expected).max() < 2e-3
    assert smooth_image(IMAGE, beta=4, space="oklab").colours.shape == IMAGE.shape


def test_progress_ends_with_the_whole_and_can_stop_the_work():
    progress = Mock()
    smooth_image(IMAGE, iterations=2, progress=progress)
    done, total = progress.call_args.args
    assert done == total
    with pytest.raises(KeyboardInterrupt):
        smooth_image(IMAGE, iterations=2, progress=Mock(side_effect=KeyboardInterrupt))
