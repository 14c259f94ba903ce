"""Images on the plane and on surfaces against truths that know neither grids nor marching."""

from __future__ import annotations

from math import ceil, log, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
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


def gaussian(t, window):
    """Sampled Gaussian of variance 2t, cut off where it falls below 0.01 of its peak and by the window."""
    y, x = np.mgrid[:window, :window] - window // 2
    kernel = np.exp(-(x**2 + y**2) / (4 * t))
    kernel[kernel < 0.01] = 0
    return kernel / kernel.sum()


def response(t, window, scheme):
    """The kernel itself: what becomes of an image with a single bright pixel."""
    image = np.zeros((2 * window + 1, 2 * window + 1))
    image[window, window] = 1
    smoothed = smooth_image(image, **LINEAR, t=t, window=window, scheme=scheme).colours[..., 0]
    reach = window // 2
    return smoothed[window - reach : window + reach + 1, window - reach : window + reach + 1]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("t", [0.2, 0.5, 2.4])
def test_without_beta_weights_lie_between_the_gaussians_of_the_true_and_the_stepwise_distance(t, scheme):
    window = window_of(t)
    y, x = np.abs(np.mgrid[:window, :window] - window // 2)
    # No way from neighbour to neighbour is shorter than the straight one, and none need be longer than along the edges:
    # of eight neighbours in one scheme, of four in the other.
    steps = np.maximum(x, y) + (sqrt(2) - 1) * np.minimum(x, y) if scheme == "triangles" else x + y
    most, least = (np.exp(-(d**2) / (4 * t)) for d in (np.hypot(x, y), steps))
    most, least = (np.where(kernel < 0.01, 0, kernel) for kernel in (most, least))
    weights = response(t, window, scheme)
    rounding = 1e-6
    assert (weights <= most / least.sum() + rounding).all()
    assert (weights >= least / most.sum() - rounding).all()


def test_where_all_distances_are_straight_an_image_is_smoothed_by_the_gaussian():
    image = noisy()
    # In 3 x 3 pixels the grid's own edges are all there is.
    smoothed = smooth_image(image, **LINEAR, t=0.5, window=3).colours
    truth = np.dstack([correlate(image[..., i], gaussian(0.5, 3)) for i in range(3)])
    inside = np.s_[1:-1, 1:-1]
    assert np.abs(smoothed - truth)[inside].max() < 1e-6  # rounding in single precision


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "first"), [("triangles", 0.05), ("metric", 0.25)])
def test_without_beta_the_kernel_tends_to_the_gaussian_as_pixels_get_smaller(scheme, first):
    # Marching errs by one order of the pixel's size h, up to log h; t in squared pixels quadruples when h is halved.
    errors = [np.abs(response(t, window_of(t), scheme) - gaussian(t, window_of(t))).sum() for t in (1, 4, 16)]
    assert errors[0] < first
    assert errors[1] < 0.8 * errors[0]
    assert errors[2] < 0.7 * errors[1]


def sphere_patch(pixels):
    """Positions on a sphere by an equal-area map about its pole, on which uniform samples stand for equal areas."""
    radius, centre = pixels / 1.6, (pixels - 1) / 2
    y, x = np.mgrid[:pixels, :pixels] - centre
    polar, azimuth = 2 * np.arcsin(np.hypot(x, y) / (2 * radius)), np.arctan2(y, x)
    unit = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    return radius, radius * np.dstack(unit)


@pytest.mark.slow
def test_on_a_sphere_a_linear_function_shrinks_as_the_integral_says_on_images_and_meshes():
    errors = []
    for pixels, t in ((33, 2.0), (65, 8.0)):
        radius, positions = sphere_patch(pixels)
        image = 0.5 + positions @ np.array([[0.36], [0.48], [0.8]]) / (2 * radius)
        reach = sqrt(-4 * t * log(0.01))

        def mean(function, t=t, radius=radius, reach=reach):
            return quad(
                lambda d: np.exp(-d * d / (4 * t)) * function(d / radius) * np.sin(d / radius), 0, reach
            )[0]

        # Degree 1 harmonics are eigenfunctions of every kernel that depends on geodesic distance (Funk, Hecke).
        truth = 0.5 + mean(np.cos) / mean(np.ones_like) * (image - 0.5)
        settings = {**LINEAR, "t": t, "units": "world"}
        mapped = smooth_image(
            image, surface=ImageSurface(positions=positions), window=window_of(t), **settings
        ).colours
        mesh = smooth(
            positions.reshape(-1, 3),
            grid_faces(pixels, pixels),
            image.reshape(-1, 1),
            **settings,
            **CONVERGING,
        ).colours
        border = ceil(1.4 * reach)
        inside = np.s_[border:-border, border:-border]
        change = np.abs(image - truth)[inside].max()
        errors.append(
            [np.abs(found - truth)[inside].max() / change for found in (mapped, mesh.reshape(image.shape))]
        )
    # Of first order: the triangulation, which has one diagonal in each square, errs more than the grid, which has both.
    assert errors[0][0] < 0.05
    assert errors[0][1] < 0.2
    assert errors[1][0] < 0.85 * errors[0][0]
    assert errors[1][1] < 0.85 * errors[0][1]


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
        mapped = smooth_image(
            image,
            surface=ImageSurface(heights=height),
            window=window_of(settings["t"]),
            scheme=scheme,
            **settings,
        )
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
    height = hills(24, 24)
    # What both sides have in common is the estimated noise, which beta and restored averages depend on.
    fixed = {"beta": 8, "clipping": "keep", **parameters}
    one, two = (
        smooth_image(i, surface=ImageSurface(heights=height, valid=valid), **fixed).colours
        for i in (image, other)
    )
    np.testing.assert_array_equal(one[~side & ~line], two[~side & ~line])
    assert not np.array_equal(one[side], two[side])


def test_a_hole_changes_nothing_further_away_than_kernels_reach():
    image, valid = noisy(40, 60), np.ones((40, 60), bool)
    valid[0, 0] = False  # makes the metric's own smoothing look for walls
    whole, holed = (
        smooth_image(image, surface=ImageSurface(valid=v), beta=8, **FIXED).colours for v in (None, valid)
    )
    # Five kernels of 3 pixels, and two metrics of 2, further on.
    assert np.abs(holed - whole)[20:, 20:].max() < 1e-6
    assert np.abs(holed - whole)[1:5, 1:5].max() > 1e-4
