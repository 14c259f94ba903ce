"""The figures of a comparison agree with published values, with other programs, and with exact results."""

import tracemalloc

import numpy as np
import pytest

from beltrami_cli.jobs.compare.figures import figures
from beltrami_cli.jobs.compare.measured import _BLOCK, ComparedPart, measure
from beltrami_cli.jobs.compare.similarity import cie_lab, delta_e_2000, structural_similarity
from beltrami_cli.surface.atlas import build_atlas, texel_areas
from beltrami_cli.surface.geometry import triangle_areas
from jobs.cut_boards import BOARD


def test_delta_e_2000_agrees_with_scikit_image_either_way():
    """Also for hues on either side of 0 degrees, and for greys, which have no hue."""
    color = pytest.importorskip("skimage.color")
    one, other = np.random.default_rng(0).uniform((0, -90, -90), (100, 90, 90), (2, 3000, 3))
    one[:900, 2], other[:900, 2] = np.random.default_rng(1).uniform(-5, 5, (2, 900))
    one[900:1000, 1:] = other[950:1050, 1:] = 0
    for first, second in ((one, other), (other, one)):
        expected = color.deltaE_ciede2000(first, second)
        np.testing.assert_allclose(delta_e_2000(first, second), expected, atol=1e-9)


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
        ComparedPart(
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


@pytest.mark.parametrize("error", [1e-30, 1e-6, 1.0])
def test_the_psnr_of_the_slightest_error_is_exact(error):
    test = np.full((2, 1), error, np.float32)
    psnr = figures([measured(np.zeros_like(test), test, [1, 1])])["psnr"]
    assert psnr == pytest.approx(-20 * np.log10(error), abs=1e-5)


def test_figures_keep_three_numbers_in_single_precision_of_a_sample():
    count = 1 << 19
    part = ComparedPart(
        name="p", kind="vertices", index=np.zeros(count, np.int8), space="srgb",
        read=lambda rows: (np.zeros((len(rows), 1), np.float32), np.full((len(rows), 1), 0.5, np.float32)),
    )  # fmt: skip
    tracemalloc.start()
    try:
        figures([measure(part)])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # Also the copy that the quantile sorts, and two masks; and less than 200 bytes for each sample of a block.
    assert peak < (3 * 4 + 4 + 2) * count + 200 * _BLOCK


def test_texels_stand_for_their_area_on_the_surface():
    surface = BOARD.surface()
    atlas = build_atlas(surface, [(BOARD.size, BOARD.size)], 4)
    np.testing.assert_allclose(texel_areas(atlas), 1 / BOARD.texels**2, rtol=1e-5)
    # Stretched along x by 2 and sheared, so that sides are not at right angles.
    surface.positions[:] = surface.positions @ np.array([[2, 0, 0], [0.7, 1, 0.3], [0, 0, 1]])
    areas = texel_areas(build_atlas(surface, [(BOARD.size, BOARD.size)], 4))
    assert areas.sum() == pytest.approx(triangle_areas(surface.positions, surface.faces).sum(), rel=1e-4)
