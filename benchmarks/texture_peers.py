"""Image filters that know nothing of the surface, each tuned on the truth."""

import itertools
import time

import numpy as np
from peers import PeerError, reason
from scene import SIGMA

MOST_ITERATIONS = 8


def bilateral(noisy, score, *, window, sigma=SIGMA):
    """Return the best scores of OpenCV's bilateral filter, iterated.

    Parameters
    ----------
    noisy : ndarray of uint8, shape (H, W, 3)
        The image.
    score : callable
        From an image in [0, 1] to a tuple of scores; the first is tuned for.
    window : int
        Texels a side.
    sigma : float
        Of the noise, by which the filter's own parameters are scaled.

    Returns
    -------
    tuple
        The scores where the first is best.
    """
    cv2 = opencv()
    image, found = noisy.astype(np.float32) / 255, []
    for colour, space in itertools.product((1, 1.5, 2, 2.7, 4), (1.2, 1.8, 3, 5)):
        smoothed = image
        for _ in range(MOST_ITERATIONS):
            smoothed = cv2.bilateralFilter(smoothed, window, colour * sigma, space)
            found.append(score(smoothed))
    return max(found, key=lambda scores: scores[0])


def nonlocal_means(noisy, score, *, sigma=SIGMA):
    """Return the best scores of scikit-image's fast non-local means."""
    restoration = scikit_image()
    image = noisy.astype(np.float32) / 255
    settings = itertools.product((0.4, 0.6, 0.8), (3, 5))
    run = restoration.denoise_nl_means
    options = {"patch_distance": 6, "fast_mode": True, "channel_axis": -1, "sigma": sigma}
    found = [score(run(image, h=h * sigma, patch_size=patch, **options)) for h, patch in settings]
    return max(found, key=lambda scores: scores[0])


def total_variation(noisy, score, *, sigma=SIGMA):
    """Return the best scores of scikit-image's total variation (Chambolle)."""
    restoration = scikit_image()
    image = noisy.astype(np.float32) / 255
    weights = (0.05, 0.07, 0.1, 0.14)
    found = [
        score(restoration.denoise_tv_chambolle(image, weight=w * sigma / SIGMA, channel_axis=-1))
        for w in weights
    ]
    return max(found, key=lambda scores: scores[0])


def bm3d(noisy, score, *, sigma=SIGMA):
    """Return the scores of BM3D with its own settings, given the true sigma."""
    try:
        import bm3d
    except ImportError as error:
        raise PeerError(reason(error)) from error
    settings = bm3d.BM3DProfile()
    settings.num_threads = 1
    return score(bm3d.bm3d_rgb(noisy / 255, sigma, settings))


def bilateral_seconds(noisy):
    """Return the CPU seconds of one pass of OpenCV's bilateral filter (d = 7, float32, one thread)."""
    cv2 = opencv()
    image = noisy.astype(np.float32) / 255
    start = time.process_time()
    cv2.bilateralFilter(image, 7, 2 * SIGMA, 1.8)
    return time.process_time() - start


def opencv():
    """Return OpenCV's module, set to use one thread."""
    try:
        import cv2
    except ImportError as error:
        raise PeerError(reason(error)) from error
    cv2.setNumThreads(1)
    return cv2


def scikit_image():
    """Return scikit-image's module of filters."""
    try:
        from skimage import restoration
    except ImportError as error:
        raise PeerError(reason(error)) from error
    return restoration
