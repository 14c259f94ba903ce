"""Images on the plane and on surfaces against truths that know neither grids nor marching."""

from math import ceil, log, sqrt

import numpy as np
import pytest
from scipy.ndimage import correlate

from beltrami_cli import smooth, smooth_image
from beltrami_cli.layers.image_surface import ImageSurface
from oracles.surfaces import grid_faces

SCHEMES = ["triangles", "metric"]
# The solver whose distances converge on finer and finer meshes, in kernels of any size.
CONVERGING = {"solver": "fast-marching", "max_samples": 10**5}
LINEAR = {"iterations": 1, "beta": 0, "metric_steps": 0, "space": "data"}
# Given, so that they are not chosen from the data, which differ between the two sides of a comparison.
FIXED = {"iterations": 5, "t": 2.4, "beta_growth": 2.0, "metric_steps": 2}
SETTINGS = {
    "sweep": FIXED,
    "plain": {**FIXED, "metric_steps": 0},
    "march": {**FIXED, "window": 17, "t": 5, "iterations": 2},
    "paper": {**FIXED, "iterations": 1, "t": 0.5, "metric_steps": 0, "scheme": "metric"},
}


def window_of(t):
    """The least odd side of a square that holds the whole kernel, with distances up to 8 per cent too long."""
    return 2 * ceil(1.08 * sqrt(-4 * t * log(0.01))) + 1


def noisy(rows=24, columns=31, channels=3, seed=0):
    y, x = np.mgrid[:rows, :columns]
    base = 0.3 + 0.4 * (x + 0.4 * y > 0.6 * columns)[..., None] + np.linspace(-0.1, 0.1, channels)
    return np.clip(base + np.random.default_rng(seed).normal(0, 0.06, base.shape), 0, 1).astype(np.float32)


def hills(rows, columns, steepness=3.0):
    y, x = np.mgrid[:rows, :columns]
    return steepness * np.sin(x / 3) * np.cos(y / 4)


def test_where_all_distances_are_straight_an_image_is_smoothed_by_the_gaussian():
    image = noisy()
    # In 3 x 3 pixels the grid's own edges are all there is: a sampled Gaussian of variance 2t = 1.
    smoothed = smooth_image(image, **LINEAR, t=0.5, window=3).colours
    kernel = np.exp(-np.add.outer(*2 * [np.array([1, 0, 1]) / 2]))
    truth = np.dstack([correlate(image[..., i], kernel / kernel.sum()) for i in range(3)])
    inside = np.s_[1:-1, 1:-1]
    assert np.abs(smoothed - truth)[inside].max() < 1e-6  # rounding in single precision


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "first", "beta"), [("triangles", 0.06, 0.5), ("metric", 0.25, 0)])
def test_parametric_and_triangulated_agree_to_first_order_on_a_height_map(scheme, first, beta):
    differences = []
    for pixels in (16, 32, 64):
        y, x = (np.mgrid[:pixels, :pixels] + 0.5) / pixels
        height = 0.15 * pixels * np.sin(2 * np.pi * x) * np.sin(2 * np.pi * y)
        image = 0.5 + 0.2 * np.sin(5 * x + 3 * y) + 0.2 / (1 + np.exp(-12 * (x + y - 1)))
        positions = np.dstack([pixels * x, pixels * y, height]).reshape(-1, 3)
        # The same surface, colours and flow, in smaller and smaller pixels.
        settings = {**LINEAR, "t": 0.5 * (pixels / 16) ** 2, "beta": beta * pixels, "units": "world"}
        surface, window = ImageSurface(heights=height), window_of(settings["t"])
        mapped = smooth_image(image, surface=surface, window=window, scheme=scheme, **settings)
        mesh = smooth(positions, grid_faces(pixels, pixels), image.reshape(-1, 1), **settings, **CONVERGING)
        difference = mapped.colours[..., 0] - mesh.colours.reshape(image.shape)
        differences.append(np.sqrt(np.mean(difference**2) / np.mean((mapped.colours[..., 0] - image) ** 2)))
    assert differences[0] < first
    assert differences[1] < 0.85 * differences[0]
    assert differences[2] < 0.8 * differences[1]


@pytest.mark.parametrize("parameters", SETTINGS.values(), ids=SETTINGS)
@pytest.mark.parametrize("wall", ["column", "diagonal", "bend"])
def test_nothing_crosses_a_wall_of_holes_one_pixel_thick(parameters, wall):
    rows, columns = np.mgrid[:24, :24]
    if wall == "bend":  # shut by corners only
        line, side = np.maximum(rows, columns) == 12, np.maximum(rows, columns) > 12
    else:
        across = columns - (12 if wall == "column" else rows)
        line, side = across == 0, across > 0
    image, valid = noisy(24, 24), ~line
    other = image.copy()
    other[side] = noisy(24, 24, seed=9)[side] ** 2
    other[line] = 0.123
    image, other = (np.rint(255 * each.clip(0, 1)).astype(np.uint8) / 255 for each in (image, other))
    height = hills(24, 24)
    # What both sides have in common is the estimated noise, which beta and restored averages depend on, and the unit of
    # colours, which is 1 of levels of 8 bits.
    fixed = {"beta": 8, "clipping": "keep", **parameters}
    surface = ImageSurface(heights=height, valid=valid)
    one, two = (smooth_image(each, surface=surface, **fixed).colours for each in (image, other))
    np.testing.assert_array_equal(one[~side & ~line], two[~side & ~line])
    assert not np.array_equal(one[side], two[side])
