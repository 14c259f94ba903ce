"""The figures of a comparison agree with published values, with other programs, and with exact results."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.jobs.compare.figures import (
    ComparedColours,
    cie_lab,
    delta_e_2000,
    figures,
    measure,
    structural_similarity,
)
from beltrami_cli.jobs.compare.parts import near_seams, seam_steps, texel_areas
from beltrami_cli.surface.atlas import build_atlas
from beltrami_cli.surface.geometry import triangle_areas
from jobs.cut_boards import BOARD, CHART, SIDE

# G. Sharma, W. Wu, E. Dalal (2005), doi:10.1002/col.20070, table I: L, a, b; L, a, b; Delta E 2000.
SHARMA = """
50.0000   2.6772 -79.7751  50.0000   0.0000 -82.7485   2.0425
50.0000   3.1571 -77.2803  50.0000   0.0000 -82.7485   2.8615
50.0000   2.8361 -74.0200  50.0000   0.0000 -82.7485   3.4412
50.0000  -1.3802 -84.2814  50.0000   0.0000 -82.7485   1.0000
50.0000  -1.1848 -84.8006  50.0000   0.0000 -82.7485   1.0000
50.0000  -0.9009 -85.5211  50.0000   0.0000 -82.7485   1.0000
50.0000   0.0000   0.0000  50.0000  -1.0000   2.0000   2.3669
50.0000  -1.0000   2.0000  50.0000   0.0000   0.0000   2.3669
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0009   7.1792
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0010   7.1792
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0011   7.2195
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0012   7.2195
50.0000  -0.0010   2.4900  50.0000   0.0009  -2.4900   4.8045
50.0000  -0.0010   2.4900  50.0000   0.0010  -2.4900   4.8045
50.0000  -0.0010   2.4900  50.0000   0.0011  -2.4900   4.7461
50.0000   2.5000   0.0000  50.0000   0.0000  -2.5000   4.3065
50.0000   2.5000   0.0000  73.0000  25.0000 -18.0000  27.1492
50.0000   2.5000   0.0000  61.0000  -5.0000  29.0000  22.8977
50.0000   2.5000   0.0000  56.0000 -27.0000  -3.0000  31.9030
50.0000   2.5000   0.0000  58.0000  24.0000  15.0000  19.4535
50.0000   2.5000   0.0000  50.0000   3.1736   0.5854   1.0000
50.0000   2.5000   0.0000  50.0000   3.2972   0.0000   1.0000
50.0000   2.5000   0.0000  50.0000   1.8634   0.5757   1.0000
50.0000   2.5000   0.0000  50.0000   3.2592   0.3350   1.0000
60.2574 -34.0099  36.2677  60.4626 -34.1751  39.4387   1.2644
63.0109 -31.0961  -5.8663  62.8187 -29.7946  -4.0864   1.2630
61.2901   3.7196  -5.3901  61.4292   2.2480  -4.9620   1.8731
35.0831 -44.1164   3.7933  35.0232 -40.0716   1.5901   1.8645
22.7233  20.0904 -46.6940  23.0331  14.9730 -42.5619   2.0373
36.4612  47.8580  18.3852  36.2715  50.5065  21.2231   1.4146
90.8027  -2.0831   1.4410  91.1528  -1.6435   0.0447   1.4441
90.9257  -0.5406  -0.9208  88.6381  -0.8985  -0.7239   1.5381
 6.7747  -0.2908  -2.4247   5.8714  -0.0985  -2.2286   0.6377
 2.0776   0.0795  -1.1350   0.9033  -0.0636  -0.5514   0.9082
"""


def test_delta_e_2000_is_that_of_the_published_pairs_either_way():
    table = np.array(SHARMA.split(), float).reshape(-1, 7)
    assert len(table) == 34
    for one, other in ((table[:, :3], table[:, 3:6]), (table[:, 3:6], table[:, :3])):
        np.testing.assert_allclose(delta_e_2000(one, other), table[:, 6], atol=0.5e-4 + 1e-9)


def test_lab_agrees_with_scikit_image():
    color = pytest.importorskip("skimage.color")
    linear = np.random.default_rng(1).random((500, 3))
    # Its matrix and white point are rounded another way, by some 5e-4 of full scale.
    np.testing.assert_allclose(cie_lab(linear), color.xyz2lab(color.rgb2xyz(_display(linear))), atol=0.05)
    np.testing.assert_allclose(cie_lab(np.ones((1, 3))), [[100, 0, 0]], atol=1e-12)


def _display(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def similarity(one, other, counts):
    return structural_similarity(lambda rows: (one[rows], other[rows]), counts)


def test_structural_similarity_agrees_with_scikit_image():
    metrics = pytest.importorskip("skimage.metrics")
    rng = np.random.default_rng(2)
    one = rng.random((40, 50, 3)).astype(np.float32)
    other = (one + rng.normal(0, 0.2, one.shape)).astype(np.float32)
    expected = metrics.structural_similarity(
        one.astype(float), other.astype(float), channel_axis=2, data_range=1.0,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    )  # fmt: skip
    whole = np.ones((40, 50), bool)
    assert similarity(one, other, whole) == pytest.approx(expected, abs=1e-9)
    assert similarity(one, one, whole) == 1


def test_structural_similarity_takes_no_notice_of_what_does_not_count():
    rng = np.random.default_rng(3)
    one, other = rng.random((2, 30, 30, 1)).astype(np.float32)
    counts = np.zeros((30, 30), bool)
    counts[5:25, 3:20] = True
    changed = np.where(counts[..., None], other, rng.random((30, 30, 1)).astype(np.float32))
    assert similarity(one, changed, counts) == similarity(one, other, counts)
    assert similarity(one, other, counts & (np.arange(30) < 12)) is None


def measured(reference, test, weights):
    return measure(
        ComparedColours(
            name="p", kind="vertices", index=np.arange(len(reference)), space="data",
            weights=np.asarray(weights, float), read=lambda rows: (reference[rows], test[rows]),
        )
    )  # fmt: skip


def test_weights_count_and_the_parts_make_the_whole():
    reference = np.zeros((4, 3), np.float32)
    test = reference.copy()
    test[1] = 0.5  # a quarter of the squared error, on a sample that weighs 3 of 6
    whole = figures([measured(reference, test, [1, 3, 1, 1])])
    assert whole["psnr"] == pytest.approx(-10 * np.log10(0.25 * 3 / 6))
    halves = [measured(reference[:2], test[:2], [1, 3]), measured(reference[2:], test[2:], [1, 1])]
    assert figures(halves)["psnr"] == pytest.approx(whole["psnr"])
    assert figures(halves)["worst"]["vertex"] == 1


def test_texels_stand_for_their_area_on_the_surface():
    surface = BOARD.surface()
    atlas = build_atlas(surface, [(BOARD.size, BOARD.size)], 4)
    np.testing.assert_allclose(texel_areas(atlas), 1 / BOARD.texels**2, rtol=1e-5)
    # Stretched along x by 2 and sheared, so that sides are not at right angles.
    surface.positions[:] = surface.positions @ np.array([[2, 0, 0], [0.7, 1, 0.3], [0, 0, 1]])
    areas = texel_areas(build_atlas(surface, [(BOARD.size, BOARD.size)], 4))
    assert areas.sum() == pytest.approx(triangle_areas(surface.positions, surface.faces).sum(), rel=1e-4)


def test_near_a_seam_are_four_texels_on_either_side():
    atlas = build_atlas(BOARD.surface(), [(BOARD.size, BOARD.size)], 4)
    near = np.zeros((BOARD.size, BOARD.size), bool)
    near.reshape(-1)[atlas.owned_texels] = near_seams(atlas)
    at = np.arange(SIDE)
    near_seam = np.abs(at + 0.5 - CHART) < 4
    rows, columns = BOARD.texel_places()
    np.testing.assert_array_equal(near[rows, columns], near_seam[:, None] | near_seam)


def test_a_step_over_a_seam_is_measured_and_a_slope_is_none():
    atlas = build_atlas(BOARD.surface(), [(BOARD.size, BOARD.size)], 4)
    rows, columns = BOARD.texel_places()
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    slope = np.stack([0.3 * x + 0.5 * y, 0.2 * y, 0 * x], axis=2)
    stepped = slope + np.where(x < 0.5, 0.1, 0)[..., None]
    measured = []
    for painting in (slope, stepped):
        image = np.zeros((BOARD.size**2, 3), np.float32)
        image[rows * BOARD.size + columns] = painting
        cells, steps = seam_steps(atlas, image[atlas.owned_texels].__getitem__)
        measured.append(steps)
    assert len(cells) == 4 * SIDE  # two seams as long as the board, each seen from both sides
    np.testing.assert_allclose(measured[0], 0, atol=1e-5)
    over_x = measured[1] > 0.05
    assert np.count_nonzero(over_x) == 2 * SIDE
    np.testing.assert_allclose(measured[1][over_x], 0.1, atol=1e-5)
    np.testing.assert_allclose(measured[1][~over_x], 0, atol=1e-5)
