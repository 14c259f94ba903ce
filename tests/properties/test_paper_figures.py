"""What the paper says of its figures, as numbers; docs/figures.md shows them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

FIGURES = Path(__file__).parents[2] / "docs" / "figures"

pytestmark = pytest.mark.slow  # 2 s for each figure, which is computed as docs/figures.md shows it


@pytest.fixture(scope="module")
def figures():
    """The modules that compute the figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FIGURES))
        import face
        import step_edge
        import waves

        yield {"step_edge": step_edge, "waves": waves, "face": face}
        for path in FIGURES.glob("*.py"):
            sys.modules.pop(path.stem, None)


@pytest.fixture(scope="module")
def step(figures):
    return figures["step_edge"], figures["step_edge"].run()


@pytest.fixture(scope="module")
def waves(figures):
    return figures["waves"], figures["waves"].run()


@pytest.fixture(scope="module")
def face(figures):
    return figures["face"], figures["face"].run()


def test_the_gaussian_blurs_a_step_edge(step):
    module, result = step
    # Ten Gaussians of variance 2 t = 1, cut off at the threshold, are one of the deviation sqrt(10) (1 - 0.047)^(1/2),
    # whose 10 to 90 per cent width is 2.563 deviations: 7.9 pixels. Distances of fast marching are some per cent too
    # long, so kernels are that much too narrow.
    assert 6.5 < module.edge_width(result.gaussian) < 7.9


def test_the_beltrami_kernel_keeps_the_step_edge(step):
    module, result = step
    # Within one pixel the mean profile of a sharp edge rises from 10 to 90 per cent over 0.8 of it.
    assert module.edge_width(result.beltrami) == pytest.approx(0.8, abs=0.05)
    assert module.step_height(result.beltrami) == pytest.approx(module.HIGH - module.LOW, rel=0.01)


def test_both_kernels_take_the_noise_away_on_both_sides(step):
    module, result = step
    before = module.noise_left(result.noisy)
    assert before == pytest.approx(module.NOISE, rel=0.05)
    # The mean over a Gaussian of variance s^2 leaves 1 / (2 s sqrt(pi)) of white noise: 0.089 for s^2 = 10. The last
    # bits are the noise of the estimate, and that the noise itself makes distances.
    assert module.noise_left(result.gaussian) < 0.14 * before
    assert module.noise_left(result.beltrami) < 0.15 * before


def test_kernels_beside_the_edge_reach_over_it_only_if_they_are_gaussian(step):
    module, result = step
    # t = 0.5: a normal distribution of variance 1 has P(x > 0.5) = 0.31 beyond half a pixel; a sampled, cut one less.
    assert 0.2 < module.share_beyond_edge(0.0, result.noisy) < 0.31
    assert module.share_beyond_edge(module.BETA, result.noisy) < 1e-6


def test_the_plane_is_smoothed_evenly(waves):
    module, result = waves
    # Sixteen squares of 56 x 56 pixels with grains of about 3: some 300 independent ones each, so that the energy of
    # the change is known to sqrt(2 / 300) = 8 %, and its root to 4 %.
    assert module.evenness(result) < 0.04


def test_level_parts_of_the_surface_are_smoothed_like_the_plane(waves):
    module, result = waves
    assert module.relative_smoothing(result, 0, module.LEVEL) == pytest.approx(1, abs=0.05)


def test_slopes_are_smoothed_less_the_steeper_they_are(waves):
    module, result = waves
    ratios = [ratio for low, high, ratio in module.smoothing_by_slope(result) if low >= 0.75 and high <= 5]
    assert (np.diff(ratios) < 0).all()
    assert module.relative_smoothing(result, module.STEEP, module.BINS[-1]) < 0.75
    # Kernels are smaller there, which is why.
    assert result.samples[1] < 0.5 * result.samples[0]


def test_kernels_on_the_face_hold_about_the_papers_twenty_pixels(face):
    module, result = face
    assert result.surface.samples == pytest.approx(module.PAPERS_SAMPLES, abs=1)
    assert result.regular_of_equal_kernels.samples == pytest.approx(result.surface.samples, abs=0.5)


def test_the_forehead_is_smoothed_as_in_the_regular_image_and_the_lips_less(face):
    module, result = face
    ratio = {
        name: module.change(result, result.surface, region) / module.change(result, result.regular, region)
        for name, region in (("forehead", result.face.forehead), ("lips", result.face.lips))
    }
    assert ratio["forehead"] == pytest.approx(1, abs=0.03)
    assert ratio["lips"] < 0.85


def test_with_kernels_of_one_size_the_surface_smooths_level_parts_more_and_its_edges_less(face):
    module, result = face
    edges = result.face.slopes > module.EDGE
    level = result.face.slopes < module.LEVEL

    def change(smoothed, region):
        return module.change(result, smoothed, region)

    for region in (result.face.forehead, level):
        assert change(result.surface, region) > 1.01 * change(result.regular_of_equal_kernels, region)
    for region in (result.face.lips, edges):
        assert change(result.surface, region) < 0.95 * change(result.regular_of_equal_kernels, region)


def test_the_two_versions_differ_at_the_edges_of_the_surface(face):
    module, result = face
    edges = result.face.slopes > module.EDGE
    level = result.face.slopes < module.LEVEL
    assert module.difference(result, edges) > 3 * module.difference(result, level)
    assert module.difference(result, result.face.lips) > 10 * module.difference(result, result.face.forehead)


def test_the_lips_come_out_nearer_to_the_face_without_noise(face):
    module, result = face
    lips = result.face.lips
    assert module.error(result, result.surface, lips) < 0.9 * module.error(result, result.regular, lips)
    whole = np.ones_like(lips)
    assert module.error(result, result.surface, whole) < 1.05 * module.error(result, result.regular, whole)
