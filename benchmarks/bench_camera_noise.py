"""Compare the defaults with BM3D on photographs with noise of cameras and coarse grain.

``python benchmarks/bench_camera_noise.py [IMAGE...]`` judges four photographs of scikit-image, and named
images, in windows of 224 x 224. A camera counts photons in linear light on a Bayer mosaic (variance A times the light,
plus B squared), which is demosaiced, encoded as sRGB, and stored in 8 bit or as JPEG. The truth is the same image
without noise. BM3D is run with 1, 1.5 and 2.2 times the true RMS noise, and its best result is reported;
``--no-peers`` leaves it out.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

import peers
from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.jobs.noise.kinds import jpeg_file
from harness import arguments, psnr, rms, show
from pixels import colours_of, smoothed, stored, windows, with_noise

CAMERAS = ((0.002, 0.005), (0.01, 0.01), (0.03, 0.02))  # A and B
GRAINS = ((2, 6), (2, 12), (3, 6), (3, 12), (4, 6), (4, 12))  # size in pixels, sigma of 255
FACTORS = (1, 1.5, 2.2)  # of the sigma that BM3D is given


def main() -> None:
    options = arguments(__doc__, "images", no_peers=False)
    rows = []
    for name, clean in windows(options.images):
        for kind, noisy, truth in cases(clean):
            ours = clipped_psnr(smoothed(noisy).colours, truth)
            noisy = colours_of(noisy)
            best = float("nan") if options.no_peers else best_of_bm3d(noisy, truth)
            rows.append((f"{name}, {kind}", clipped_psnr(noisy, truth), best, ours))
    means = np.mean([row[1:] for row in rows], axis=0).tolist()
    show([*rows, ("mean", *means)], options, ("image, noise", "input", "BM3D", "by default"))


def cases(clean: Float32s) -> Iterator[tuple[str, Array | bytes, Array]]:
    """Yield for each kind of noise its name, the noisy image or the bytes of a JPEG file, and the truth."""
    truth = with_noise(clean, "camera", shot=0.0, read=0.0)
    for seed, (shot, read) in enumerate(CAMERAS):
        noisy = with_noise(clean, "camera", shot=shot, read=read, seed=seed)
        yield f"camera {shot}, {read}", stored(noisy), truth
        yield f"camera {shot}, {read}, JPEG 95", jpeg_file(noisy, 95), truth
    for seed, (size, sigma) in enumerate(GRAINS):
        grain = with_noise(clean, "grain", grain_size=float(size), sigma=sigma / 255, seed=seed)
        yield f"grain of {size}, {sigma}", stored(grain), clean


def best_of_bm3d(noisy: Array, truth: Array) -> float:
    sigma = rms(noisy - truth)
    score = partial(clipped_psnr, truth=truth)
    return max(peers.bm3d(255 * noisy, score, sigma=factor * sigma) for factor in FACTORS)


def clipped_psnr(image: Array, truth: Array) -> float:
    return psnr(np.clip(image, 0, 1), truth)


if __name__ == "__main__":
    main()
