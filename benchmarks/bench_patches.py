"""Collaborative patches beside the kernel alone and beside flat denoisers, on textures and on vertices.

``BELTRAMI_EXTRA_MESHES=FOLDER python benchmarks/bench_patches.py`` judges samples, photographs of scikit-image,
and the models of a folder, and prints the tables of docs/performance.md. The program works on whole surfaces; of larger
images the peers see a part, and all are judged there. Rows go to stderr as soon as they are known.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import patch_scenes
import texture_files
import texture_peers
from peers import PeerError

import beltrami_cli
from beltrami_cli.flow.parameters import parameters_with
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise import noise_file
from beltrami_cli.jobs.settings import NoiseSettings

SIGMAS = (20, 10, 40)
SIDE = 224  # texels a side of what is judged
MARGIN = 20  # texels around it that peers see, too: half of BM3D's window
MOST_COMPARED = 40_000  # texels of which colours are compared as they look
INPUT, OFF, DEFAULT, BM3D, MEANS = "input", "patches off", "default", "BM3D", "non-local means"
PEERS = {
    "bilateral": partial(texture_peers.bilateral, window=7),
    MEANS: texture_peers.nonlocal_means,
    BM3D: texture_peers.bm3d,
}
METHODS = (INPUT, *PEERS, OFF, DEFAULT)


@dataclass(frozen=True)
class Judged:
    """An image with noise: per method the PSNR over covered texels, near seams, and the mean CIEDE2000; `whole`: the
    PSNR over the whole image with patches off, and by default.
    """

    name: str
    sigma: int
    figures: dict
    whole: tuple


def main():
    """Judge everything; print tables, and which bars are missed."""
    parser = argparse.ArgumentParser(description="Benchmark collaborative patches.")
    parser.add_argument("--sigma", type=int, nargs="+", default=SIGMAS, help="of the noise, of 255")
    parser.add_argument("--only", default="", help="names that hold this")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="images at a time")
    parser.add_argument("--peers", type=Path, metavar="FOLDER", help="keep results of peers, for other runs")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="write what is judged there")
    parser.add_argument("--no-textures", action="store_true")
    parser.add_argument("--no-vertices", action="store_true")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    missed = []
    with ProcessPoolExecutor(options.jobs) as pool:
        if not options.no_textures:
            names = [name for name in patch_scenes.textured_names() if options.only in name]
            wanted = itertools.product(options.sigma, names)
            rows = told(pool.map(partial(judge_textures, options), wanted), texture_line)
            missed += show_textures(rows)
        if not options.no_vertices:
            with tempfile.TemporaryDirectory() as folder:
                paths = [p for p in patch_scenes.write_vertices(folder) if options.only in p.name]
                wanted = itertools.product(options.sigma, paths)
                rows = told(pool.map(judge_vertices, wanted), vertex_line)
                missed += show_vertices(rows)
    print("\nMissed:" if missed else "\nNo bar was missed.")
    print(*(f"- {what}" for what in missed), sep="\n")
    sys.exit(1 if missed else 0)


def told(groups, line):
    """Return all rows, by name and noise; each goes to stderr when it is known."""
    rows = []
    for row in itertools.chain.from_iterable(groups):
        print(line(row), file=sys.stderr, flush=True)
        rows.append(row)
    return sorted(rows, key=lambda row: row.sigma)


def judge_textures(options, wanted):
    """Judge the images of a scene with noise of `sigma` of 255."""
    sigma, name = wanted
    scene = patch_scenes.textured(name)
    if scene is None:
        return []
    noisy = patch_scenes.with_noise(scene, sigma / 255)
    ours = {OFF: smoothed(scene, noisy, "off"), DEFAULT: smoothed(scene, noisy, "auto")}
    found = []
    for number in patch_scenes.judged_images(scene):
        where = patch_scenes.part(scene, number, SIDE)
        results = {INPUT: noisy[number][where]} | peer_results(
            scene, noisy, number, where, sigma, options.peers
        )
        results |= {method: images[number][where] for method, images in ours.items()}
        masks = scene.covered[number][where], scene.near_seams[number][where]
        clean = scene.clean[number]
        figures = {method: judge(image, clean[where], masks) for method, image in results.items()}
        whole = tuple(psnr(images[number], clean, scene.covered[number]) for images in ours.values())
        label = short_name(name) + (f" {number + 1}" if len(scene.clean) > 1 else "")
        if options.keep:
            keep(options.keep / f"{label}-{sigma}.npz", clean[where], masks[0], results)
        found.append(Judged(label, sigma, figures, whole))
    return found


def smoothed(scene, noisy, patches):
    """Return the 8-bit images of a scene after ``beltrami smooth IN OUT``."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "noisy.glb", Path(folder) / "smooth.glb"
        texture_files.write_glb(source, scene, noisy)
        smooth(source, target, patches)
        return [to_8_bit(image) for image in texture_files.read_images(target)]


def smooth(source, target, patches):
    """Smooth a file on one thread with nothing given but whether patches are used."""
    settings = beltrami_cli.SmoothSettings(parameters_with({"patches": patches, "threads": 1}))
    beltrami_cli.smooth_file(source, target, settings, job=Job(overwrite=True))


def peer_results(scene, noisy, number, where, sigma, kept):
    """Return the results of the peers on a part of an image, of those that are installed."""
    around = tuple(slice(max(0, part.start - MARGIN), part.stop + MARGIN) for part in where)
    inner = tuple(slice(w.start - a.start, w.stop - a.start) for w, a in zip(where, around, strict=True))
    clean, covered = scene.clean[number][where], scene.covered[number][where]
    source, results = np.ascontiguousarray(noisy[number][around]), {}
    for name, run in PEERS.items():
        key = hashlib.sha256(repr((name, sigma, source.shape)).encode() + source.tobytes()).hexdigest()[:24]
        path = kept / f"{key}.npy" if kept else None
        if path is None or not path.exists():
            tried = []

            def score(image, tried=tried):
                tried.append(to_8_bit(image)[inner])
                return psnr(tried[-1], clean, covered), len(tried) - 1

            try:
                _, best = run(source, score, sigma=sigma / 255)
            except PeerError as missing:
                print(f"{name}: {missing}", file=sys.stderr)
                continue
            results[name] = tried[best]
            if path:
                path.parent.mkdir(parents=True, exist_ok=True)
                np.save(path, tried[best])
        else:
            results[name] = np.load(path)
    return results


def to_8_bit(image):
    """Return an image as it is stored: all methods are clipped and rounded alike."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def psnr(image, clean, mask):
    """Return the PSNR over a mask, at most that of rounding to 8 bit."""
    if not mask.any():
        return np.nan
    error = np.square(image[mask] / np.float32(255) - clean[mask]).mean(dtype=float)
    return float(-10 * np.log10(max(error, 1 / 12 / 255**2)))


def judge(image, clean, masks):
    """Return the PSNR over covered texels, near seams, and the mean CIEDE2000."""
    return (
        psnr(image, clean, masks[0]),
        psnr(image, clean, masks[1]),
        colour_difference(image, clean, masks[0]),
    )


def colour_difference(image, clean, mask):
    """Return the mean CIEDE2000 over a mask, or over evenly chosen texels of it."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    chosen = slice(None, None, max(1, int(mask.sum()) // MOST_COMPARED))
    return float(deltaE_ciede2000(rgb2lab(image[mask][chosen] / 255), rgb2lab(clean[mask][chosen])).mean())


def short_name(name):
    """Return what a model is called."""
    return Path(name).name.split("-clean")[0].split(".")[0]


def keep(path, clean, covered, results):
    """Write what was judged, to be looked at."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, clean=to_8_bit(clean), covered=covered, **results)


def texture_line(row):
    """Return a row of the table of textures."""
    cells = (
        f"{covered:.2f} / {near:.2f} / {colour:.2f}"
        if np.isfinite(near)
        else f"{covered:.2f} / - / {colour:.2f}"
        for covered, near, colour in (row.figures.get(method, (np.nan,) * 3) for method in METHODS)
    )
    return f"| {row.name} | {row.sigma} | " + " | ".join(cells) + f" | {row.whole[1] - row.whole[0]:+.2f} |"


def show_textures(rows):
    """Print the table, its means; return the bars that are missed."""
    print(f"\n| model | sigma | {' | '.join(METHODS)} | default - off, whole |")
    print("| --- | ---: |" + " ---: |" * (len(METHODS) + 1))
    print(*map(texture_line, rows), sep="\n")
    missed = []
    for sigma in sorted({row.sigma for row in rows}):
        own = [row for row in rows if row.sigma == sigma]
        found = {m: np.array([row.figures.get(m, (np.nan,) * 3) for row in own]) for m in METHODS}
        with np.errstate(all="ignore"):
            means = {method: tuple(np.nanmean(values, axis=0)) for method, values in found.items()}
        whole = tuple(np.mean([row.whole for row in own], axis=0))
        print(texture_line(Judged("**mean**", sigma, means, whole)))
        missed += missed_on_average(sigma, means, found) + missed_anywhere(own)
    return missed


def missed_on_average(sigma, means, found):
    """Return the bars for means that are missed."""
    above = np.nanmean(found[DEFAULT] - found[BM3D], axis=0)
    missed = [
        f"sigma {sigma}: {gain:+.2f} dB above BM3D {where}, not {bar}"
        for gain, bar, where in ((above[0], 0.7, "over covered texels"), (above[1], 1.0, "near seams"))
        if gain < bar
    ]
    ours = means[DEFAULT][2]
    missed += [
        f"sigma {sigma}: mean CIEDE2000 {ours:.3f}, {peer} {means[peer][2]:.3f}"
        for peer in (MEANS, BM3D)
        if ours >= means[peer][2]
    ]
    return missed


def missed_anywhere(rows):
    """Return the bars for single images that are missed."""
    missed = []
    for row in rows:
        ours, theirs = row.figures[DEFAULT], row.figures.get(BM3D)
        if theirs and ours[0] < theirs[0] - 0.3:
            missed.append(f"{row.name}, sigma {row.sigma}: {ours[0] - theirs[0]:+.2f} dB beside BM3D")
        if row.whole[1] < row.whole[0] - 0.1:
            missed.append(
                f"{row.name}, sigma {row.sigma}: {row.whole[1] - row.whole[0]:+.2f} dB beside patches off"
            )
    return missed


def judge_vertices(wanted):
    """Judge a file with coloured vertices and noise of `sigma` of 255."""
    sigma, path = wanted
    found = []
    with tempfile.TemporaryDirectory() as folder:
        noisy, target = Path(folder) / "noisy.ply", Path(folder) / "smooth.ply"
        noise_file(path, noisy, NoiseSettings(sigma=sigma / 255), job=Job(overwrite=True))
        clean = vertex_colours(path)
        everywhere = np.ones(len(clean), bool)
        for patches in (None, "off", "auto"):
            if patches:
                smooth(noisy, target, patches)
            image = to_8_bit(vertex_colours(target if patches else noisy))
            found.append((psnr(image, clean, everywhere), colour_difference(image, clean, everywhere)))
    figures = dict(zip((INPUT, OFF, DEFAULT), found, strict=True))
    return [Judged(short_name(str(path)), sigma, figures, (found[1][0], found[2][0]))]


def vertex_colours(path):
    """Return the colours of the vertices of a file."""
    return np.asarray(open_document(str(path)).painted().colours)[:, :3]


def vertex_line(row):
    """Return a row of the table of vertices."""
    cells = " | ".join(f"{value:.2f} / {colour:.2f}" for value, colour in row.figures.values())
    return f"| {row.name} | {row.sigma} | {cells} | {row.whole[1] - row.whole[0]:+.2f} |"


def show_vertices(rows):
    """Print the table of vertices, its means; return the bars that are missed."""
    print(f"\n| vertices | sigma | {INPUT} | {OFF} | {DEFAULT} | default - off |\n| --- |" + " ---: |" * 5)
    print(*map(vertex_line, rows), sep="\n")
    missed = []
    for sigma in sorted({row.sigma for row in rows}):
        own = [row for row in rows if row.sigma == sigma]
        means = {m: tuple(np.mean([row.figures[m] for row in own], axis=0)) for m in (INPUT, OFF, DEFAULT)}
        whole = tuple(np.mean([row.whole for row in own], axis=0))
        print(vertex_line(Judged("**mean**", sigma, means, whole)))
        gain = whole[1] - whole[0]
        if gain < 1.0:
            missed.append(f"vertices, sigma {sigma}: {gain:+.2f} dB above patches off, not 1.0")
        lost = [row for row in own if row.whole[1] < row.whole[0] - 0.1]
        missed += [
            f"vertices, {row.name}, sigma {sigma}: {row.whole[1] - row.whole[0]:+.2f} dB" for row in lost
        ]
    return missed


if __name__ == "__main__":
    main()
