"""The program without any parameter beside its own best setting by hand: on noise of cameras, and on coarse grain.

``python benchmarks/bench_by_hand.py [IMAGE...]`` judges the images and the noise of bench_camera_noise.py. The
best of some thirty settings is chosen by the truth: the noise given, larger and smaller, the strengths, and parameters
of the kernel with and without patches. ``--kind grain`` takes the kinds of noise that begin so. Without parameters
results should be within 0.5 dB of the best on noise of cameras, and within 1 dB on grain.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np
from bench_camera_noise import cases, colours_of, images, psnr, smoothed


def main():
    """Judge all images; print a line for each kind of noise."""
    parser = argparse.ArgumentParser(description="Compare with the best setting by hand.")
    parser.add_argument("images", nargs="*", type=Path)
    parser.add_argument("--kind", default="", help="only noise whose name begins so")
    options = parser.parse_args()
    lost = {"camera": [], "grain": []}
    print("| image, noise | by default | best by hand | lost | with |\n|---|---|---|---|---|")
    for name, clean in images(options.images):
        for kind, noisy, truth in cases(clean):
            if not kind.startswith(options.kind):
                continue
            ours = psnr(smoothed(noisy).colours, truth)
            rms = float(np.sqrt(np.mean((colours_of(noisy) - truth) ** 2)))
            tried = [(psnr(smoothed(noisy, **each).colours, truth), each) for each in settings(rms)]
            best, chosen = max(tried, key=lambda each: each[0])
            lost[kind.split()[0]].append(best - ours)
            words = ", ".join(f"{key} {value}" for key, value in chosen.items())
            print(f"| {name}, {kind} | {ours:.2f} | {best:.2f} | {best - ours:.2f} | {words} |", flush=True)
    for kind, each in lost.items():
        if each:
            print(f"{kind}: {np.mean(each):.2f} dB lost on average, at most {max(each):.2f}")


def settings(rms):
    """Return what is tried by hand, for noise of a root mean square."""
    return [
        *({"noise": f"{100 * factor * rms:.3g}%"} for factor in (0.7, 1, 1.4, 2)),
        *({"strength": each} for each in ("gentle", "strong")),
        *(
            {"iterations": n, "t": 8.0, "beta": beta, "window": window, "patches": patches}
            for n, beta, window, patches in product((2, 5), (4.0, 8.0, 16.0), (7, 11), ("on", "off"))
        ),
    ]


if __name__ == "__main__":
    main()
