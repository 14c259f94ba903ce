"""Smoothing over an atlas against the truths that do not know of charts; no kernel reaches through a slit."""

import numpy as np
import pytest

from beltrami_cli._native import halo_repeats
from beltrami_cli.flow.parameters import PRESETS, KernelParameters
from oracles import surfaces
from oracles.textured import quads, slit
from properties.textured_planes import Board, phantom, smooth_image, textured

RANDOM = np.random.default_rng(1)


def uncut(cells, texels):
    return Board(cells, texels, cells, cells * texels, 1, [(0, 0, 0, False)])


PLAIN = {"metric_steps": 0, "beta": 8.0}
REGULARISED = {"metric_scale": 0.7, "metric_steps": 2, "beta": 8.0}


@pytest.mark.parametrize("parameters", [PLAIN, REGULARISED], ids=["plain", "regularised"])
@pytest.mark.parametrize(
    "places",
    [
        [(0, 0, 0, False), (0, 1, 0, False), (1, 0, 0, False), (1, 1, 0, False)],
        [(1, 0, 0, False), (1, 1, 0, False), (0, 1, 0, False), (0, 0, 0, False)],
        [(1, 1, 1, False), (0, 0, 2, False), (0, 1, 3, False), (1, 0, 1, False)],
        [(0, 0, 0, True), (1, 1, 1, True), (0, 1, 2, False), (1, 0, 3, True)],
    ],
    ids=["apart", "shuffled", "turned", "mirrored"],
)
def test_a_plane_cut_into_charts_gives_the_uncut_result(places, parameters):
    board = Board(cells=8, texels=6, block=4, slot=32, slots=2, places=places)
    whole = uncut(8, 6)
    picture = phantom(48)
    cut, plan = smooth_image(board.surface(), board.image_of(picture), **parameters)
    truth, _ = smooth_image(whole.surface(), picture, **parameters)
    assert plan.manifold.jumps == 0
    # The same arithmetic in another order: sums of some 30 float32 terms, over four iterations.
    assert np.abs(cut[board.texel_places()] - truth).max() < 2e-5


def test_a_cylinder_is_smoothed_across_its_seam_like_the_periodic_plane():
    cells, texels, rounds = 48, 2, 3
    side = cells * texels
    flat, faces = surfaces.plane(17, cells + 1)
    angle = 2 * np.pi * flat[:, 0] / cells
    radius = 0.5 / np.sin(np.pi / cells)  # facets of width 1
    rolled = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), flat[:, 1]])
    rolled[np.isclose(flat[:, 0], cells)] = rolled[np.isclose(flat[:, 0], 0)]
    uv = flat[faces][:, :, :2] / [cells, 16]
    x = np.arange(side) + 0.5
    smooth = 0.5 + 0.3 * np.cos(2 * np.pi * x / side)[None, :, None] * np.ones((32, 1, 2))
    picture = smooth + np.random.default_rng(5).normal(0, 20 / 255, smooth.shape)
    cylinder, _ = smooth_image(textured(rolled, faces, uv), picture, **PLAIN)
    long_flat, long_faces = surfaces.plane(17, rounds * cells + 1)
    long_uv = long_flat[long_faces][:, :, :2] / [rounds * cells, 16]
    long_picture = np.tile(picture, (1, rounds, 1))
    plane, _ = smooth_image(textured(long_flat, long_faces, long_uv), long_picture, **PLAIN)
    # Texels on both sides of a fold of 7.5 degrees are nearer by 1 - cos(3.75 degrees) = 0.2 %; a sample may cross the
    # cut-off for it, where it weighs 0.01 of some 30.
    difference = np.abs(cylinder - plane[:, side : 2 * side])
    assert difference.mean() < 3e-4
    assert difference.max() < 0.02


def two_charts(jump, pattern=0.0):
    board = Board(8, 6, 4, 32, 2, [(0, 0, 0, False), (0, 1, 0, False), (1, 0, 0, False), (1, 1, 0, False)])
    y = np.arange(48)
    step = jump + pattern * np.sign(np.sin(y / 2))[:, None] * np.ones((48, 48))
    base = np.where(np.arange(48)[None, :] >= 24, step, 0.0)[..., None] + 0.4
    noise = np.random.default_rng(2).normal(0, 8 / 255, (48, 48, 3))
    return board, base + noise


@pytest.mark.parametrize(("jump", "pattern", "expected"), [(0, 0, 0), (33 / 255, 0, 2), (0, 40 / 255, 2)])
def test_a_seam_whose_sides_really_differ_is_distinguished_from_a_noisy_one(jump, pattern, expected):
    board, picture = two_charts(jump, pattern)
    _, plan = smooth_image(board.surface(), board.image_of(picture))
    assert plan.manifold.jumps == expected


def test_nothing_is_smoothed_over_a_seam_whose_sides_really_differ():
    board, picture = two_charts(33 / 255)
    image = board.image_of(picture)
    places = board.texel_places()
    right = np.zeros(image.shape[:2], bool)
    right[places[0][:, 24:], places[1][:, 24:]] = True
    moved = image.copy()
    moved[right] += 0.05
    a, _ = smooth_image(board.surface(), image, beta=5.0)
    b, _ = smooth_image(board.surface(), moved, beta=5.0)
    assert np.array_equal(a[places][:, :24], b[places][:, :24])


def test_the_preset_of_the_paper_is_the_papers_kernel():
    kernel = KernelParameters(**PRESETS["paper"])
    assert (kernel.t, kernel.iterations, kernel.threshold, kernel.window) == (0.5, 1, 0.01, 7)
    assert not kernel.is_regularised(0)
    assert kernel.scheme == "metric"


def test_repeats_are_those_within_reach_over_the_same_seam():
    rows, columns, reach = 20, 30, 2
    cells = np.sort(RANDOM.choice(rows * columns, 300, replace=False))
    sources, seams = RANDOM.integers(0, 9, 300), RANDOM.integers(-1, 2, 300).astype(np.int32)
    repeats = halo_repeats(rows, columns, cells, sources, seams, reach, 2)
    row, column = np.divmod(cells, columns)
    near = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column)) <= reach
    same = (sources[:, None] == sources) & (seams[:, None] == seams)
    assert np.array_equal(repeats.ravel()[cells], (near & same).sum(axis=1))
    assert (np.delete(repeats.ravel(), cells) == 1).all()


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
    surface = textured(positions, faces, (positions[faces][..., :2] + shift) / size)
    ends = (TEXELS * ax, TEXELS * ay), (TEXELS * bx, TEXELS * by)
    return slit(surface, *ends, (False, True)) if cut else surface


def sides(line):
    """Texels on the left and on the right of the cut, that no kernel reaches around its end in two iterations."""
    size = SIDE * TEXELS + 2
    y, x = np.mgrid[0:size, 0:size]
    left = LINES[line][3](x, y)
    on_line = (x == 24) if line != "aslant" else (x == y)  # may belong to either side
    far = y > 2 * TEXELS + 17
    return left & ~on_line & far, ~left & ~on_line & far


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("line", LINES)
def test_the_colours_of_the_two_sides_of_a_slit_do_not_mix(line, scheme):
    """A colour on one side changes nothing on the other, though both sides touch; it does without the cut."""
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


@pytest.mark.parametrize("scheme", [{}, {"scheme": "metric"}, {"window": 17}])
def test_no_kernel_reaches_over_charts_that_are_neighbours_in_the_image_only(scheme):
    parameters = {**REGULARISED, **scheme, "iterations": 2}
    places = [(0, 0, 0, False), (0, 1, 0, False), (1, 0, 0, False), (1, 1, 0, False)]
    board = Board(cells=8, texels=6, block=4, slot=24, slots=2, places=places)  # slots without gaps
    surface = board.surface()
    apart = surface.positions.copy()
    chart = (surface.uv.mean(axis=1) >= 0.5) @ [1, 2]
    positions = apart[surface.faces].reshape(-1, 3) + 100.0 * np.repeat(chart, 3)[:, None]
    faces = np.arange(len(positions), dtype=np.int32).reshape(-1, 3)
    image = board.image_of(phantom(48))
    together, _ = smooth_image(textured(positions, faces, surface.uv), image, **parameters)
    for number in range(4):
        alone = image.copy()
        rows, columns = divmod(number, 2)
        kept = np.zeros(image.shape[:2], bool)
        kept[24 * rows : 24 * rows + 24, 24 * columns : 24 * columns + 24] = True
        alone[~kept] = RANDOM.random((np.count_nonzero(~kept), 3))
        result, _ = smooth_image(textured(positions, faces, surface.uv), alone, **parameters)
        assert np.array_equal(result[kept], together[kept])


def test_a_fine_chart_is_not_spoilt_by_a_coarse_one_beyond_its_seam():
    """Stripes that coarse texels do not resolve: each is shown in several fine cells there, but is one sample."""
    ratio = 24 / 64
    positions, faces = surfaces.plane(2, 3)
    corners = positions[faces][:, :, :2]
    fine = corners.mean(axis=1)[:, 0] < 1
    uv = np.where(fine[:, None, None], 64 * corners, [80, 0] + 64 * ratio * (corners - [1, 0])) / 128
    apart = np.concatenate([positions, positions + np.array([9, 0, 0])])
    torn = textured(apart, np.where(fine[:, None], faces, faces + len(positions)), uv)
    y, x = np.mgrid[:128, :128]
    along = np.where(x < 64, x + 0.5, 64 + (x - 79.5) / ratio)  # on the surface, in fine texels
    stripes = 0.3 + 0.4 * ((along + (y + 0.5) * np.where(x < 64, 1, 1 / ratio)) // 8 % 2)[..., None]
    noisy = stripes + np.random.default_rng(8).normal(0, 20 / 255, stripes.shape)
    settings = {"beta": 18.0, "beta_growth": 1.5, "t": 4.0, "iterations": 8, "metric_steps": 2}
    whole, alone = (
        np.mean((smooth_image(surface, noisy, **settings)[0] - stripes)[:64, 60:64] ** 2)
        for surface in (textured(positions, faces, uv), torn)
    )
    assert whole < alone


def test_a_regularised_metric_resists_the_noise_that_it_does_not_see():
    """Distances from smoothed colours reach further over noise, and beta means the same in both."""
    board = uncut(16, 6)
    picture = phantom(96)
    clean = picture - np.random.default_rng(5).normal(0, 20 / 255, (96, 96, 3))

    def psnr(**parameters):
        result, _ = smooth_image(board.surface(), picture, iterations=1, beta=18.0, t=2.4, **parameters)
        return -10 * np.log10(np.mean((result - clean) ** 2))

    assert psnr(metric_scale=0.7, metric_steps=1) > psnr(metric_steps=0) + 1
