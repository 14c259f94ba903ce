"""Texels around charts that faces look up are refilled where they continue the chart; others keep their colours."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.layers.settings import SmoothSettings
from formats.image_files import encode

HEIGHT, WIDTH = 48, 96
KERNEL = KernelParameters(iterations=4, t=4.0, beta=4.0, beta_growth=1.0, metric_steps=1, free=())
SIGMA = 6
TOP, BOTTOM = 8, 40
# Columns of the left and the right half of a plane in the image; the halves meet at a seam.
LEFT, RIGHT = (8, 40), (56, 88)
CLEAR = 8  # rows at the ends of a seam where the plane ends, too


def halves(folder, pixels, extra=""):
    """Write a plane of two charts, whose texture is given, and more of the model, whose first vertex has number 7."""
    (folder / "plane.png").write_bytes(encode(pixels.astype(np.uint8), "png"))
    (folder / "plane.mtl").write_text("newmtl skin\nmap_Kd plane.png\n")
    lines = ["mtllib plane.mtl", "usemtl skin"]
    lines += [f"v {x} {y} 0" for y in (0, BOTTOM - TOP) for x in (0, 32, 64)]
    for first, last in (LEFT, RIGHT):
        lines += [f"vt {x / WIDTH} {1 - y / HEIGHT}" for y in (TOP, BOTTOM) for x in (first, last)]
    lines += ["f 1/1 2/2 5/4 4/3", "f 2/5 3/6 6/8 5/7"]
    (folder / "plane.obj").write_text("\n".join(lines) + "\n" + extra)
    return folder / "plane.obj"


def point(column, row):
    """Return a large triangle elsewhere that is one point of the image, between texel centres."""
    place = f"vt {column / WIDTH} {1 - row / HEIGHT}\n"
    return "v 0 0 90\nv 60 0 90\nv 0 60 90\n" + place + "f 7/9 8/9 9/9\n"


def smoothed(model, **options):
    out = model.parent / "out"
    out.mkdir()
    beltrami_cli.smooth_file(model, out / "plane.obj", SmoothSettings(kernel=KERNEL, **options))
    return read_image((out / "plane.png").read_bytes(), "plane.png").pixels.astype(int)


def noisy(level=128.0, sigma=SIGMA, seed=4):
    random = np.random.default_rng(seed)
    return np.clip(np.rint(level + random.normal(0, sigma, (HEIGHT, WIDTH, 3))), 0, 255)


@pytest.mark.parametrize("distance", [2, 9])
def test_what_a_face_without_texels_shows_keeps_its_colour(tmp_path, distance):
    """Next to the halo of a chart, and where the gutter is filled from it."""
    column, row = LEFT[1] + distance, 24
    pixels = noisy()
    patch = slice(row - 3, row + 3), slice(column - 2, column + 3)
    pixels[patch] = 1
    found = smoothed(halves(tmp_path, pixels, point(column, row)))
    shown = found[row - 1 : row + 1, column - 1 : column + 1]
    assert (shown == 1).all()
    others = found[row + 8, column - 1 : column + 1]
    assert (others != pixels[row + 8, column - 1 : column + 1]).any()


def test_a_noisy_gutter_that_continues_its_chart_is_refilled(tmp_path):
    pixels = noisy()
    found = smoothed(halves(tmp_path, pixels))
    rows = slice(TOP + CLEAR, BOTTOM - CLEAR)
    for column in (LEFT[0] - 1, LEFT[1], RIGHT[0] - 1, RIGHT[1]):
        assert pixels[rows, column].std() > 0.7 * SIGMA
        # A few may be noise too rare to be distinguished from another colour.
        errors = np.abs(found[rows, column] - 128).max(axis=1)
        assert np.mean(errors < 2 * SIGMA) > 0.9
        assert found[rows, column].std() < 0.5 * SIGMA


def test_a_border_of_another_colour_stays(tmp_path):
    """A white line around a chart, which is no continuation of it."""
    pixels = noisy()
    line = slice(TOP - 1, BOTTOM + 1), LEFT[0] - 1
    pixels[line] = 250
    found = smoothed(halves(tmp_path, pixels))
    assert (found[line] == 250).all()
    assert (found[TOP:BOTTOM, LEFT[0] - 3] < 200).all()


COLUMNS = np.arange(WIDTH)[:, None]
# What lies close around charts, and is none of theirs.
OTHER_COLOURS = {
    "another colour": noisy(90.0, seed=5),
    "flat areas": np.full((HEIGHT, WIDTH, 3), 90.0),
    "a dark background": np.zeros((HEIGHT, WIDTH, 3)),
    "stripes through the colour of the charts": noisy(128 + 60 * np.sin(COLUMNS), seed=5),
    "texture around the colour of the charts": noisy(sigma=10 * SIGMA, seed=5),
}


@pytest.mark.parametrize("kind", OTHER_COLOURS)
def test_colours_of_others_around_charts_stay(tmp_path, kind):
    """At open borders, and where halos continue the chart over it."""
    outside = np.ones((HEIGHT, WIDTH), bool)
    for first, last in (LEFT, RIGHT):
        outside[TOP:BOTTOM, first:last] = False
    pixels = noisy()
    pixels[outside] = OTHER_COLOURS[kind][outside]
    found = smoothed(halves(tmp_path, pixels))
    assert (found != pixels)[~outside].mean() > 0.5
    # A pattern that passes through the colour of the chart is within three deviations of it here and there, and then
    # becomes that colour.
    changed = np.abs(found - pixels)[outside].max(axis=1)
    assert np.mean(changed > 0) < 0.05
    assert changed.max() < 6 * SIGMA


def test_an_exposure_step_is_taken_from_the_gutter_too(tmp_path):
    """What continued a chart continues it still when all its colours move."""
    pixels = noisy()
    pixels[:, WIDTH // 2 :] += 20
    found = smoothed(halves(tmp_path, pixels), level_seams=True)
    rows = slice(TOP + CLEAR, BOTTOM - CLEAR)
    left, right = found[rows, LEFT[1] - 4 : LEFT[1] + 1], found[rows, RIGHT[0] - 1 : RIGHT[0] + 4]
    assert abs(left.mean() - right.mean()) < SIGMA
    for gutter, chart in ((left[:, -1], left[:, :-1]), (right[:, 0], right[:, 1:])):
        assert abs(np.median(gutter) - np.median(chart)) < SIGMA / 2
