"""No kernel reaches through a slit in the surface, however closed it is."""

from __future__ import annotations

import numpy as np
import pytest

from oracles.textured import quads, slit, textured
from properties.textured_planes import smooth_image

SIDE, TEXELS = 8, 6  # squares, and texels of each
LINES = {  # start and end of the cut, where it leads through the border, and which texels lie on its left
    "between texels": ((4, 2), (4, 8), 0.0, lambda x, y: x < 24),
    "through texels": ((4, 2), (4, 8), 0.5, lambda x, y: x < 24),
    "aslant": ((2, 2), (8, 8), 0.25, lambda x, y: x < y),
}
SCHEMES = {
    "sweep": {"metric_steps": 0},
    "regularised": {"metric_scale": 0.7, "metric_steps": 2},
    "metric": {"metric_steps": 0, "scheme": "metric"},
    "march": {"metric_steps": 0, "window": 17},
}


def cut_plane(line, cut):
    (ax, ay), (bx, by), shift, _ = LINES[line]
    positions, faces = quads(SIDE, SIDE, TEXELS, np.ones((SIDE, SIDE)))
    size = SIDE * TEXELS + 2
    surface = textured(positions, faces, positions[faces][..., :2] + shift, [(size, size)])
    return (
        slit(surface, (TEXELS * ax, TEXELS * ay), (TEXELS * bx, TEXELS * by), (False, True))
        if cut
        else surface
    )


def sides(line):
    """Texels on the left and on the right of the cut, that no kernel reaches around its end in two iterations."""
    size = SIDE * TEXELS + 2
    y, x = np.mgrid[0:size, 0:size]
    left = LINES[line][3](x, y)
    beside = (x == 24) if line != "aslant" else (x == y)  # may belong to either side
    far = y > 2 * TEXELS + 17
    return left & ~beside & far, ~left & ~beside & far


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("line", LINES)
def test_the_colours_of_the_two_sides_of_a_slit_do_not_mix(line, scheme):
    """What is painted on one side changes nothing on the other, though both sides touch; it does without the cut."""
    left, right = sides(line)
    picture = np.random.default_rng(3).normal(0.5, 0.08, (*left.shape, 3))
    other = picture.copy()
    other[right] = np.random.default_rng(4).normal(0.5, 0.08, (*left.shape, 3))[right]
    parameters = {"beta": 4.0, "t": 0.8, "iterations": 2, **SCHEMES[scheme]}
    parameters["threshold"] = 0.1 if scheme == "march" else 0.01  # the march's window does not end the kernel
    for cut in (True, False):
        surface = cut_plane(line, cut)
        results = [smooth_image(surface, image, **parameters)[0][left] for image in (picture, other)]
        same = (results[0] == results[1]).all(axis=1)
        if cut:
            assert same.all()
        else:
            assert np.count_nonzero(~same) > 3 * TEXELS
