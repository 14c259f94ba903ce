"""Pictures without noise, by formulas: like a photograph, flat areas, line art and shapes; and white noise on them."""

import numpy as np

_PALETTE = np.array(
    [[0.2, 0.3, 0.7], [0.8, 0.2, 0.2], [0.9, 0.8, 0.3], [0.3, 0.6, 0.3], [0.6, 0.6, 0.6], [0.4, 0.2, 0.5]]
)


def photograph(side, seed=1, contrast=0.12):
    """Return colours of many scales, whose power falls with frequency as in photographs, and mostly one hue."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    frequency[0, 0] = 1
    spectrum = np.fft.rfft2(random.standard_normal((3, side, side))) / frequency**1.2
    planes = np.moveaxis(np.fft.irfft2(spectrum, s=(side, side)), 0, 2)
    colours = planes @ np.array([[1, 1, 1], [0.3, 0, -0.3], [0.1, -0.2, 0.1]])
    return np.clip(0.5 + contrast * colours / colours.std(axis=(0, 1)), 0, 1)


def flat_areas(side, width=40):
    """Return squares of few colours."""
    y, x = np.mgrid[:side, :side] // width
    return _PALETTE[(3 * x + 5 * y) % len(_PALETTE)]


def line_art(side):
    """Return dark rings and lines on white paper."""
    y, x = np.mgrid[:side, :side]
    is_ink = (np.hypot(x - side / 2, y - side / 2) % 16 < 2) | ((x + 2 * y) % 23 < 2)
    return np.repeat(np.where(is_ink, 0.1, 1.0)[..., None], 3, axis=2)


def with_noise(clean, sigma, seed=0, *, cut_off=True):
    noisy = clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return (noisy.clip(0, 1) if cut_off else noisy).astype(np.float32)


def psnr(colours, clean):
    return -10 * np.log10(np.mean((colours - clean) ** 2))


def shapes(side):
    """Return a disc on a slope, stripes, and a slope, in [0.25, 0.75], so that noise is hardly cut off."""
    y, x = np.mgrid[:side, :side] / side
    disc = (x - 0.45) ** 2 + (y - 0.5) ** 2 < 0.08
    stripes = (x + y) % 0.4 < 0.2
    return np.stack([np.where(disc, 0.7, 0.35 + 0.1 * x), np.where(stripes, 0.3, 0.6), 0.3 + 0.4 * y], axis=2)
