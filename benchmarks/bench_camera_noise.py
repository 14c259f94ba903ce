"""Noise as cameras make it, and coarse grain, on photographs: the program without any parameter beside BM3D.

``python benchmarks/bench_camera_noise.py [IMAGE...]`` judges four photographs of scikit-image, and named
images, in windows of 224 x 224. A camera counts photons in linear light on a Bayer mosaic (variance A times the light,
plus B squared), which is demosaiced, encoded as sRGB, and stored in 8 bit or as JPEG. The truth is the same without
noise. BM3D is told 1, 1.5 and 2.2 times the true root mean square of the noise, and the best of these counts.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import texture_peers

import beltrami_cli
from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.noise import NoiseTargets, add_grain, jpeg_file, seen_by_camera
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface.baking import Cells

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
            ours = psnr(smoothed(noisy).colours, truth)
            noisy = colours_of(noisy)
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
    """Yield each kind of noise: its name, the noisy image, or the bytes of a JPEG file, and the truth."""
    truth = with_noise(clean, "camera", shot=0.0, read=0.0)
    for seed, (shot, read) in enumerate(CAMERAS):
        noisy = with_noise(clean, "camera", shot=shot, read=read, seed=seed)
        yield f"camera {shot}, {read}", stored(noisy), truth
        yield f"camera {shot}, {read}, JPEG 95", jpeg_file(noisy, 95), truth
    for seed, (size, sigma) in enumerate(GRAINS):
        grain = with_noise(clean, "grain", size=float(size), sigma=sigma / 255, seed=seed)
        yield f"grain of {size}, {sigma}", stored(grain), clean


def with_noise(image, kind, **wanted):
    """Return what `beltrami noise` makes of an image, before it is rounded."""
    settings, shape = NoiseSettings(kind=kind, **wanted), image.shape[:2]
    row, column = np.indices(shape).reshape(2, -1)
    none = np.zeros_like(row)
    grains = NoiseTargets(image.reshape(-1, 3).astype(np.float32), np.arange(row.size))
    if kind == "camera":
        noisy = seen_by_camera(grains, Cells([shape], none, row, column, none), settings)
    else:
        places = np.column_stack([column, row, none]).astype(float)
        noisy = add_grain(grains, places, np.ones(row.size), settings)
    return noisy.reshape(image.shape)


def stored(image):
    """Round to 8 bit."""
    return (np.rint(255 * np.clip(image, 0, 1)) / 255).astype(np.float32)


@dataclass(frozen=True)
class Smoothed:
    """What became of an image: its colours, the noise that was read in it, and the interval told for its PSNR."""

    colours: Any
    noise: Any
    interval: Any  # None: it was left as it is; []: nothing was told


def smoothed(noisy, **parameters):
    """Smooth an image, or a JPEG file."""
    if not isinstance(noisy, bytes):
        result = beltrami_cli.smooth_image(noisy, **parameters)
        choice = result.choice
        return Smoothed(result.colours, result.noise, None if choice is None else choice.interval or [])
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.jpg", Path(folder) / "out.png"
        source.write_bytes(noisy)
        report = beltrami_cli.smooth_file(source, target, **parameters).image
        choice, noise = report.choice, np.array(list(report.noise.values()))
        return Smoothed(
            colours_of(target.read_bytes()), noise, None if choice is None else choice["interval"] or []
        )


def colours_of(image):
    """Return an image in [0, 1], which may be a file."""
    return read_image(image, "an image").pixels / np.float32(255) if isinstance(image, bytes) else image


def best_of_bm3d(noisy, truth):
    """Return the best PSNR of BM3D at several strengths."""
    sigma = float(np.sqrt(np.mean((noisy - truth) ** 2)))
    score = partial(psnr, truth=truth)
    return max(texture_peers.bm3d(255 * noisy, score, sigma=factor * sigma) for factor in FACTORS)


def psnr(image, truth):
    return float(-10 * np.log10(np.mean((np.clip(image, 0, 1) - truth) ** 2)))


if __name__ == "__main__":
    main()
