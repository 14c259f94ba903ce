"""Whether the interval in which the PSNR is said to be holds it, over noise of many kinds; no parameter is given.

``python benchmarks/bench_honesty.py [IMAGE...]`` judges four photographs of scikit-image, and the middle of
named images, in windows of 224 x 224, with noise of some thirty kinds: white, by level, correlated, coarse, left by
JPEG at qualities of 75 to 98, enlarged, of two photographs in one, of dark and bright ones, and of cameras.
``--vertices`` judges colours that were baked from such windows onto so many vertices, each from the nearest pixel.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bench_camera_noise import SIDE, cases, colours_of, images, psnr, smoothed, stored
from scipy.ndimage import gaussian_filter, zoom
from scipy.spatial import Delaunay

import beltrami_cli
from beltrami_cli.jobs.noise import jpeg_file
from beltrami_cli.surface.records import linear_to_srgb, srgb_to_linear

NEAR = 0.3  # relative error of noise that is read well


def main():
    """Judge all images; print a line for each kind, and how many intervals hold the truth and readings are right."""
    parser = argparse.ArgumentParser(description="Judge the interval of the estimated PSNR.")
    parser.add_argument("images", nargs="*", type=Path)
    parser.add_argument("--vertices", type=int, metavar="COUNT", help="onto which colours are baked")
    parser.add_argument("--only", default="", help="kinds that begin so")
    options = parser.parse_args()
    held, read_well = [], []
    for name, clean in images(options.images):
        for kind, noisy, truth in [*kinds(stored(clean)), *cases(stored(clean))]:
            if not kind.startswith(options.only):
                continue
            found = judged(noisy, truth, options.vertices)
            true = psnr(found.colours, found.truth)
            read, rms = (
                255 * float(np.sqrt(np.mean(np.square(each))))
                for each in (found.noise, found.noisy - found.truth)
            )
            read_well.append(abs(read / rms - 1) <= NEAR)
            case = f"{name}, {kind}, noise of {rms:.1f} read as {read:.1f}"
            if not found.interval:
                what = "left as it is" if found.interval is None else "nothing told"
                print(f"{case}: {what}, {true:.1f} dB")
                continue
            least, most = found.interval
            held.append(least <= true and (most is None or true <= most))
            end = "" if most is None else f" to {most:.1f}"
            verdict = "" if held[-1] else "  MISSED"
            print(f"{case}: {true:.1f} dB, said {least:.1f}{end}{verdict}", flush=True)
    print(f"{100 * np.mean(held):.0f} % of {len(held)} intervals hold the truth")
    print(f"noise of {np.sum(read_well)} of {len(read_well)} is read within {100 * NEAR:.0f} %")


@dataclass(frozen=True)
class Judged:
    """Colours that were smoothed, what was said of them, and what they were."""

    colours: Any
    noise: Any
    interval: Any  # None: left as it is; empty: nothing told
    noisy: Any
    truth: Any


def judged(noisy, truth, vertices):
    """Smooth an image, or what is baked from it onto so many vertices."""
    pixels = colours_of(noisy)
    if not vertices:
        result = smoothed(noisy)
        return Judged(result.colours, result.noise, result.interval, pixels, truth)
    places = np.random.default_rng(3).uniform(2, SIDE - 2, (vertices, 2))
    column, row = places.astype(int).T
    relief = np.column_stack([places, 6 * np.sin(places[:, 0] / 30)])
    seen, sought = (image[row, column].astype(np.float32) for image in (pixels, truth))
    result = beltrami_cli.smooth(relief, Delaunay(places).simplices, seen)
    interval = None if result.choice is None else result.choice.interval or ()
    return Judged(result.colours, [*result.noise.values()], interval, seen, sought)


def kinds(clean):
    """Yield the name of each kind of noise, the noisy image, or the bytes of a JPEG file, and the truth."""
    random = np.random.default_rng(2)

    def white(sigma, like=clean):
        return like + sigma / 255 * random.standard_normal(like.shape)

    for sigma in (3, 5, 10, 20, 40):
        yield f"white {sigma}", stored(white(sigma)), clean
    light = srgb_to_linear(clean).astype(float)
    shot = light + random.standard_normal(light.shape) * np.sqrt(0.01 * light + 1e-4)
    yield "shot 0.01", stored(linear_to_srgb(np.clip(shot, 0, 1))), clean
    for sigma, width in ((10, 0.7), (20, 0.7), (10, 1.2)):
        noise = gaussian_filter(random.standard_normal(clean.shape), (width, width, 0))
        yield f"blurred by {width}, {sigma}", stored(clean + sigma / 255 / noise.std() * noise), clean
    for quality in (75, 85, 92, 98):
        yield f"JPEG {quality}", jpeg_file(white(10), quality), clean
    small = stored(zoom(clean, (0.5, 0.5, 1), order=1))
    large = zoom(small, (2, 2, 1), order=1)
    for sigma in (10, 20):
        yield (
            f"enlarged, {sigma}",
            stored(zoom(stored(white(sigma, small)), (2, 2, 1), order=1)),
            stored(large),
        )
    halves = np.where(np.arange(SIDE) < SIDE // 2, 5, 20)[:, None, None]
    yield "5 and 20", stored(white(halves)), clean
    dark, bright = stored(0.3 * clean), stored(0.7 + 0.3 * clean)
    yield "dark, 10", stored(white(10, dark)), dark
    yield "bright, 10", stored(white(10, bright)), bright


if __name__ == "__main__":
    main()
