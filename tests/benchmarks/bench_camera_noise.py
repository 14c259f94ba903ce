"""Noise as cameras make it, and coarse grain, on photographs: the program without any parameter beside BM3D.

``python tests/benchmarks/bench_camera_noise.py [IMAGE...]`` judges four photographs of scikit-image, and named
images, in windows of 224 x 224. A camera counts photons in linear light on a Bayer mosaic (variance A times the light,
plus B squared), which is demosaiced, encoded as sRGB, and stored in 8 bit or as JPEG. The truth is the same without
noise. BM3D is told 1, 1.5 and 2.2 times the true root mean square of the noise, and the best of these counts.
"""

from __future__ import annotations

import argparse
import io
from functools import partial
from pathlib import Path

import numpy as np
import texture_peers
from scipy.ndimage import convolve, zoom

import beltrami_cli
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear

SIDE = 224
CAMERAS = ((0.002, 0.005), (0.01, 0.01), (0.03, 0.02))
GRAINS = ((2, 6), (2, 12), (3, 6), (3, 12), (4, 6), (4, 12))
FACTORS = (1, 1.5, 2.2)
CORNERS = {
    "astronaut": (20, 130),
    "coffee": (100, 150),
    "chelsea": (40, 110),
    "immunohistochemistry": (150, 150),
}


def main():
    """Judge all images with all kinds of noise; print a table."""
    parser = argparse.ArgumentParser(description="Benchmark noise of cameras and grain.")
    parser.add_argument("images", nargs="*", type=Path, help="judged, too, in their middle")
    parser.add_argument("--no-peers", action="store_true", help="without BM3D")
    options = parser.parse_args()
    print("| image, noise | input | BM3D | by default | gain |\n|---|---|---|---|---|")
    gains = []
    for name, clean in images(options.images):
        for kind, noisy, truth in cases(clean):
            ours = psnr(beltrami_cli.smooth_image(noisy).colours, truth)
            best = float("nan") if options.no_peers else best_of_bm3d(noisy, truth)
            gains.append((ours - psnr(noisy, truth), ours - best))
            row = psnr(noisy, truth), best, ours, ours - best
            print(f"| {name}, {kind} |", " | ".join(f"{value:.2f}" for value in row), "|", flush=True)
    over_input, over_peer = np.array(gains).T
    over = f"{over_input.mean():+.2f} dB over the input, {over_peer.mean():+.2f} over BM3D"
    print(f"mean: {over} (least {over_peer.min():+.2f})")


def images(paths):
    """Yield names and windows of images, float32, shape (R, C, 3), in [0, 1]."""
    import skimage.data
    import skimage.io

    for name, (top, left) in CORNERS.items():
        whole = getattr(skimage.data, name)()[..., :3] / np.float32(255)
        yield name, whole[top : top + SIDE, left : left + SIDE]
    for path in paths:
        whole = skimage.io.imread(path)[..., :3] / np.float32(255)
        top, left = ((size - SIDE) // 2 for size in whole.shape[:2])
        yield path.stem, whole[top : top + SIDE, left : left + SIDE]


def cases(clean):
    """Yield each kind of noise: its name, the noisy image and the truth."""
    random = np.random.default_rng(1)
    truth = seen_by_camera(clean, 0, 0, random)
    for shot, read in CAMERAS:
        noisy = seen_by_camera(clean, shot, read, random)
        yield f"camera {shot}, {read}", stored(noisy), truth
        yield f"camera {shot}, {read}, JPEG 95", as_jpeg(noisy, 95), truth
    for size, sigma in GRAINS:
        coarse = random.standard_normal((-(-SIDE // size) + 1, -(-SIDE // size) + 1, 3))
        grain = zoom(coarse, (size, size, 1), order=1)[1 : SIDE + 1, 1 : SIDE + 1]
        yield f"grain of {size}, {sigma}", stored(clean + sigma / 255 * grain), clean


def seen_by_camera(clean, shot, read, random):
    """Return what a camera with a Bayer mosaic and bilinear demosaicing makes of an image."""
    light = srgb_to_linear(clean).astype(float)
    masks = np.zeros((3, *light.shape[:2]))
    masks[0, ::2, ::2] = masks[2, 1::2, 1::2] = masks[1, ::2, 1::2] = masks[1, 1::2, ::2] = 1
    mosaic = np.einsum("kij,ijk->ij", masks, light)
    mosaic += random.standard_normal(mosaic.shape) * np.sqrt(shot * mosaic + read**2)
    corner = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
    planes = [convolve(mosaic * masks[k], cross if k == 1 else corner, mode="mirror") for k in range(3)]
    return linear_to_srgb(np.clip(np.stack(planes, axis=2), 0, 1)).astype(np.float32)


def stored(image):
    """Round to 8 bit."""
    return (np.rint(255 * np.clip(image, 0, 1)) / 255).astype(np.float32)


def as_jpeg(image, quality):
    """Return what JPEG of a quality, with colour at half the resolution, makes of an image."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.uint8(255 * stored(image) + 0.5)).save(file, "JPEG", quality=quality, subsampling=2)
    return np.asarray(Image.open(file)) / np.float32(255)


def best_of_bm3d(noisy, truth):
    """Return the best PSNR of BM3D at several strengths."""
    sigma = float(np.sqrt(np.mean((noisy - truth) ** 2)))
    score = partial(psnr, truth=truth)
    return max(texture_peers.bm3d(255 * noisy, score, sigma=factor * sigma) for factor in FACTORS)


def psnr(image, truth):
    return float(-10 * np.log10(np.mean((np.clip(image, 0, 1) - truth) ** 2)))


if __name__ == "__main__":
    main()
