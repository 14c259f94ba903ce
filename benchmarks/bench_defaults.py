"""Without any parameter given, against image filters that are tuned on the truth.

``python benchmarks/bench_defaults.py`` prints the table of docs/tuning.md. Textured models in the folder that the
environment variable BELTRAMI_EXTRA_MESHES names are judged, too. Noise is Gaussian, of 20 of 255.
"""

import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import texture_files
import texture_peers
from bench_textures import scenes, scorer

import beltrami_cli
from beltrami_cli.flow.parameters import parameters_with

FILTERS = {
    "bilateral": partial(texture_peers.bilateral, window=7),
    "non-local means": texture_peers.nonlocal_means,
    "total variation": texture_peers.total_variation,
}
COVERED, NEAR_SEAMS = 0.0, 0.8  # dB above each filter, on average


def main():
    """Judge all images; print a table, and the means with their goals."""
    print("| | " + " | ".join(["beltrami", *FILTERS]) + " |")
    print("| --- |" + " ---: |" * (1 + len(FILTERS)))
    gains = []
    for scene in scenes(False):
        for number, image in enumerate(smoothed(scene)):
            score = scorer(scene, number)
            ours = score(image)
            others = [run(scene.noisy[number], score) for run in FILTERS.values()]
            gains.append(np.subtract(ours, others))
            reported = " | ".join(f"{covered:.2f}, {near:.2f}" for covered, near in (ours, *others))
            print(f"| {scene.name}, image {number + 1} | {reported} |", flush=True)
    met = True
    for name, gain in zip(FILTERS, np.swapaxes(gains, 0, 1), strict=True):
        covered, near = gain[:, 0].mean(), np.nanmean(gain[:, 1])
        met = met and covered >= COVERED and near >= NEAR_SEAMS
        print(
            f"\nAbove {name}: {covered:+.2f} dB over covered texels, {near:+.2f} dB near seams.", flush=True
        )
    sys.exit(0 if met else 1)


def smoothed(scene):
    """Return the images of a scene after ``beltrami smooth IN OUT``."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "noisy.glb", Path(folder) / "smooth.glb"
        texture_files.write_glb(source, scene, scene.noisy)
        beltrami_cli.smooth_file(source, target, beltrami_cli.SmoothSettings(parameters_with({})))
        return texture_files.read_images(target)


if __name__ == "__main__":
    main()
