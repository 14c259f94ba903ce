"""Quality, time and memory of the kernel on textures, beside image filters: ``make bench``.

Textured models in the folder that the environment variable BELTRAMI_EXTRA_MESHES names are judged, too. ``--json
FILE`` writes the rows; ``--quick`` looks at two samples only, to see that everything runs.
"""

import argparse
import json
import os
import sys
import tempfile
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import texture_files
import texture_peers
import texture_scene
from bench_triangulated import Row, show
from peers import PeerError
from scene import ROOT
from texture_timing import memory_rows, smoothing, time_rows

import beltrami_cli
from beltrami_cli.errors import BeltramiError
from beltrami_cli.jobs.job import Job

SAMPLES = ("head-tex", "torus-two", "mirrored", "tiled", "sphere-exr", "scan")
MODELS = {".obj", ".glb", ".gltf", ".ply"}
WINDOWS = (7, 11)  # as large as ours, and larger
FILTERS = {
    **{f"bilateral (OpenCV, d = {d}), iterated": partial(texture_peers.bilateral, window=d) for d in WINDOWS},
    "non-local means (scikit-image)": texture_peers.nonlocal_means,
    "total variation (scikit-image)": texture_peers.total_variation,
}
CONTRASTS = (1.0, 1.4, 2.0, 2.8)  # beta times the noise
GUIDED = (0, 1, 2, 3)  # iterations with the regularised metric
PLAIN = (0, 1, 2, 4, 6)  # and without, after them
STEPS = (2.4, 4.0, 8.0)  # time step: what the bilateral filter's spatial sigma is to it
GROWTHS = (1.0, 1.5, 2.5)  # of beta from one iteration to the next
START = (1.4, 2, 2, 4.0, 1.5)


def main():
    """Run all benchmarks; print a table, write JSON."""
    parser = argparse.ArgumentParser(description="Benchmark the kernel on textures.")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    parser.add_argument("--quick", action="store_true", help="two samples only")
    parser.add_argument("--no-quality", action="store_true", help="time and memory only")
    parser.add_argument("--repeats", type=int, default=5, help="runs per time (default: 5)")
    options = parser.parse_args()
    rows = [*time_rows(options.repeats), *memory_rows()]
    if not options.no_quality:
        rows += quality_rows(options.quick)
    show(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


def smooth(source, target, settings, clipping="restore"):
    """Smooth a model in this process."""
    contrast, guided, plain, step, growth = settings
    others = {"beta_growth": growth, "clipping": clipping, "threads": None}
    chosen = smoothing(guided + plain, contrast, guided, step, **others)
    beltrami_cli.smooth_file(source, target, chosen, job=Job(overwrite=True))


def quality_rows(quick):
    """Measure the PSNR over covered texels, and near seams, beside the filters; all tuned on the truth.

    Rows are also printed on stderr when they are known, for all of them together take long.
    """
    rows, gains = [], []
    for scene in scenes(quick):
        try:
            ours = list(tuned(scene))
        except BeltramiError as error:
            rows.append(Row(scene.name, str(error)))
            continue
        for number, found in enumerate(ours):
            more, beside = image_rows(scene, number, *found)
            rows += more
            gains.append(beside)
            print(*(f"{row.what}: {row.value}" for row in more), sep="\n", file=sys.stderr, flush=True)
    return rows + mean_rows(gains)


def image_rows(scene, number, best, settings, torn, unrestored):
    """Return the rows of an image, and by how much ours is better than each filter."""
    where = f"{scene.name}, image {number + 1}: PSNR, near seams"
    score, noisy, beside = scorer(scene, number), scene.noisy[number], {}
    rows = [Row(f"{where}: noisy", decibels(score(noisy / np.float32(255))))]
    for name, run in FILTERS.items():
        try:
            reached = run(noisy, score)
        except PeerError as missing:
            rows.append(Row(f"{where}: {name}", str(missing)))
            continue
        rows.append(Row(f"{where}: {name}", decibels(reached)))
        beside[name] = np.subtract(best, reached)
    reported = "c {}, {} regularised and {} plain iterations, t {}, growth {}".format(*settings)
    rows.append(Row(f"{where}: beltrami, {reported}", decibels(best)))
    rows.append(Row(f"{where}: beltrami, the same with --clipping keep", decibels(unrestored)))
    if np.isfinite(torn[1]):
        halo = best[1] - torn[1]
        what = f"{where}: across seams against torn at seams"
        rows.append(Row(what, f"{halo:+.2f} dB near seams", ">= -0.1 dB", halo >= -0.1))
    return rows, beside


def mean_rows(gains):
    """Return the mean gains over each filter; goals are set beside the bilateral one."""
    rows = []
    for name in FILTERS:
        found = np.array([gain[name] for gain in gains if name in gain]).reshape(-1, 2)
        for column, goal, what in ((0, 0.5, "covered texels"), (1, 1.0, "near seams")):
            finite = found[np.isfinite(found[:, column]), column]
            if not len(finite):
                continue
            mean = float(finite.mean())
            reported = f"mean of {len(finite)} images, {what}: beltrami above {name}", f"{mean:+.2f} dB"
            rows.append(
                Row(*reported, f">= +{goal} dB", mean >= goal) if "bilateral" in name else Row(*reported)
            )
    return rows


def scenes(quick):
    """Yield the samples and the models of the extra folder, without noise."""
    names = SAMPLES[:2] if quick else SAMPLES
    paths = [min((ROOT / "sample_data").glob(f"{name}-clean.[gop][lb]*")) for name in names]
    for path in paths if quick else [*paths, *extra_models()]:
        try:
            scene = texture_scene.from_file(path)
        except (BeltramiError, ValueError) as error:
            print(f"passed over: {error}", file=sys.stderr)
            continue
        if scene.clean:
            yield scene


def extra_models():
    """Return the models of the extra folder."""
    extra = os.environ.get("BELTRAMI_EXTRA_MESHES")
    return sorted(path for path in Path(extra).rglob("*") if path.suffix in MODELS) if extra else []


def tuned(scene):
    """Yield per image the best scores of ours, the settings, and the scores of the same settings on the torn model and
    with averages of clipped noise kept.

    One setting after the other is varied, from a start, until none gets better.
    """
    with tempfile.TemporaryDirectory() as folder:
        whole, torn, target = (Path(folder) / f"{name}.glb" for name in ("whole", "torn", "target"))
        texture_files.write_glb(whole, scene, scene.noisy)
        texture_files.write_glb(torn, scene, scene.noisy, torn=True)
        known = {}

        def scores(settings, source=whole, *more):
            if (settings, source, more) not in known:
                smooth(source, target, settings, *more)
                found = texture_files.read_images(target)
                known[settings, source, more] = [scorer(scene, k)(image) for k, image in enumerate(found)]
            return known[settings, source, more]

        for number in range(len(scene.clean)):
            best, before = START, None
            while best != before:
                before = best
                for axis, choices in ((2, PLAIN), (0, CONTRASTS), (4, GROWTHS), (1, GUIDED), (3, STEPS)):
                    tried = [(*best[:axis], choice, *best[axis + 1 :]) for choice in choices]
                    best = max(tried, key=lambda settings: scores(settings)[number][0])
            others = scores(best, torn)[number], scores(best, whole, "keep")[number]
            yield scores(best)[number], best, *others


def scorer(scene, number):
    """Return the function that gives the PSNR of an image over covered texels, and over those near seams."""
    clean, masks = scene.clean[number], (scene.covered[number], scene.near_seams[number])

    def score(image):
        errors = ((np.asarray(image, np.float32) - clean) ** 2).mean(axis=2)
        return tuple(float(-10 * np.log10(errors[mask].mean())) if mask.any() else np.nan for mask in masks)

    return score


def decibels(scores):
    """Return scores as text."""
    return ", ".join("no seams" if np.isnan(value) else f"{value:.2f} dB" for value in scores)


if __name__ == "__main__":
    main()
