"""Check that --strength gentle, normal and strong differ as documented, on many kinds of noise.

``python benchmarks/bench_strengths.py [IMAGE...]`` judges four photographs of scikit-image, and the middle of
named images, in windows of 224 x 224: the RMS change, which must grow with the strength on every one, and the PSNR
against the truth, which may be lower than that of normal by 1.5 dB for gentle and 1 dB for strong on average.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

import beltrami_cli
from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.jobs.noise.kinds import as_jpeg
from harness import arguments, psnr, rms, show
from pixels import stored, windows, with_noise

BEST = 60.0  # dB, above which differences are invisible
STRENGTHS = ("gentle", "normal", "strong")


def main() -> None:
    options = arguments(__doc__, "images")
    rows: list[tuple[Any, ...]] = []
    for name, clean in windows(options.images):
        for kind, noisy, truth in cases(stored(clean)):
            smoothed = [beltrami_cli.smooth_image(noisy, strength=each).colours for each in STRENGTHS]
            changes = [255 * rms(each - noisy) for each in smoothed]
            gentle, normal, strong = (min(BEST, psnr(each, truth)) for each in smoothed)
            is_wrong = any(a >= b > 0 or a > b for a, b in pairwise(changes))  # clean ones may stay
            costs = normal - gentle, normal - strong
            rows.append((f"{name}, {kind}", *changes, normal, *costs, int(is_wrong)))
    means = np.mean([row[1:] for row in rows], axis=0).tolist()
    head = (
        "image, noise", *(f"change: {each}" for each in STRENGTHS), "PSNR: normal", "cost of gentle", "of strong",
    )  # fmt: skip
    show([*rows, ("mean", *means)], options, (*head, "not in order"))


def cases(clean: Float32s) -> Iterator[tuple[str, Array, Array]]:
    """Yield the name of each kind of noise, the noisy image and the truth."""
    random = np.random.default_rng(3)
    yield "clean", clean, clean
    for sigma in (5, 12, 25):
        yield f"white {sigma}", stored(clean + sigma / 255 * random.standard_normal(clean.shape)), clean
    seen = with_noise(clean, "camera", shot=0.0, read=0.0)
    for shot, read in ((0.002, 0.005), (0.02, 0.015)):
        noisy = with_noise(clean, "camera", shot=shot, read=read)
        yield f"camera {shot}, {read}", stored(noisy), seen
        yield f"camera {shot}, {read}, JPEG 95", as_jpeg(noisy, 95), seen
    for size, sigma in ((2, 12), (3, 6), (4, 12)):
        grain = with_noise(clean, "grain", grain_size=float(size), sigma=sigma / 255)
        yield f"grain of {size}, {sigma}", stored(grain), clean
    for quality in (80, 92):
        white = clean + 10 / 255 * random.standard_normal(clean.shape)
        yield f"white 10, JPEG {quality}", as_jpeg(np.asarray(white, np.float32), quality), clean


if __name__ == "__main__":
    main()
