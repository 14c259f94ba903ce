"""What the paper says of its figures, as numbers; docs/figures.md shows them."""

import sys
from pathlib import Path

import numpy as np
import pytest

FIGURES = Path(__file__).parents[2] / "docs" / "figures"

# 2 s for each figure, which is computed as docs/figures.md shows it.
pytestmark = [pytest.mark.slow, pytest.mark.uninstrumented]


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


def test_the_beltrami_kernel_keeps_a_step_edge_that_the_gaussian_blurs(figures):
    module = figures["step_edge"]
    result = module.run()
    # Ten Gaussians of variance 2 t = 1, cut off at the threshold, are one of the deviation sqrt(10) (1 - 0.047)^(1/2),
    # whose 10 to 90 per cent width is 2.563 deviations: 7.9 pixels. Distances of fast marching are some per cent too
    # long, so kernels are that much too narrow.
    assert 6.5 < module.edge_width(result.gaussian) < 7.9
    # Within one pixel the mean profile of a sharp edge rises from 10 to 90 per cent over 0.8 of it.
    assert module.edge_width(result.beltrami) == pytest.approx(0.8, abs=0.05)
    assert module.step_height(result.beltrami) == pytest.approx(module.HIGH - module.LOW, rel=0.01)
    # The mean over a Gaussian of variance s^2 leaves 1 / (2 s sqrt(pi)) of white noise: 0.089 for s^2 = 10. The last
    # bits are the noise of the estimate, and that the noise itself makes distances.
    before = module.noise_left(result.noisy)
    assert module.noise_left(result.gaussian) < 0.14 * before
    assert module.noise_left(result.beltrami) < 0.15 * before
    # t = 0.5: a normal distribution of variance 1 has P(x > 0.5) = 0.31 beyond half a pixel; a sampled, cut one less.
    assert 0.2 < module.share_beyond_edge(0.0, result.noisy) < 0.31
    assert module.share_beyond_edge(module.BETA, result.noisy) < 1e-6


def test_slopes_are_smoothed_less_the_steeper_they_are_and_level_parts_like_the_plane(figures):
    module = figures["waves"]
    result = module.run()
    # Sixteen squares of 56 x 56 pixels with grains of about 3: some 300 independent ones each, so that the energy of
    # the change is known to sqrt(2 / 300) = 8 %, and its root to 4 %.
    assert module.evenness(result) < 0.04
    assert module.relative_smoothing(result, 0, module.LEVEL) == pytest.approx(1, abs=0.05)
    ratios = [ratio for low, high, ratio in module.smoothing_by_slope(result) if low >= 0.75 and high <= 5]
    assert (np.diff(ratios) < 0).all()
    # Kernels are smaller there, which is why.
    assert result.samples[1] < 0.5 * result.samples[0]


def test_the_lips_of_the_face_are_smoothed_less_than_in_the_regular_image(figures):
    module = figures["face"]
    result = module.run()
    forehead, lips = result.face.forehead, result.face.lips
    assert result.surface.samples == pytest.approx(module.PAPERS_SAMPLES, abs=1)
    ratio = {
        name: module.change(result, result.surface, region) / module.change(result, result.regular, region)
        for name, region in (("forehead", forehead), ("lips", lips))
    }
    assert ratio["forehead"] == pytest.approx(1, abs=0.03)
    assert ratio["lips"] < 0.85
    assert module.difference(result, lips) > 10 * module.difference(result, forehead)
    assert module.error(result, result.surface, lips) < 0.9 * module.error(result, result.regular, lips)
