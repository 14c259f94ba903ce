"""Time and memory of smoothing textures."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import texture_files
import texture_peers
import texture_scene
from bench_triangulated import Row
from peers import PeerError
from scene import ROOT, SIGMA, SMOOTH

import beltrami_cli
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.texture_layer import TextureLayer

TEXELS = 1024
STEP = 2.4
SCALE = beltrami_cli.KernelParameters().metric_scale


def smoothing(iterations, contrast, guided, step=STEP, *, threads=1, **others):
    """Return the settings of some iterations, the first `guided` of them with the regularised metric."""
    settings = {
        "iterations": iterations,
        "t": step,
        "beta": contrast / SIGMA,
        "window": 7,
        "threads": threads,
    }
    scale = SCALE if guided else 0.0
    kernel = beltrami_cli.KernelParameters(metric_scale=scale, metric_steps=guided, **settings, **others)
    return beltrami_cli.SmoothSettings(kernel=kernel)


def time_rows(repeats):
    """Measure an iteration and the set-up, in CPU time of one thread, on a torus in 16 charts.

    All iterations start from the noisy colours. They and the peer take turns, so that a busy machine slows both.
    """
    scene = texture_scene.torus(TEXELS)
    covered = int(scene.covered[0].sum())
    times = {"bilateral": [], "plain": [], "regularised": [], "set-up": []}
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "noisy.glb"
        texture_files.write_glb(source, scene, scene.noisy)
        for _ in range(repeats):
            try:
                times["bilateral"].append(texture_peers.bilateral_seconds(scene.noisy[0]))
            except PeerError as missing:
                print(missing, file=sys.stderr)
            for kind, guided in (("regularised", 1), ("plain", 0)):
                setup, iteration = stage_seconds(source, guided)
                times[kind].append(iteration)
            times["set-up"].append(setup)
    seconds = {what: float(np.median(found)) if found else np.nan for what, found in times.items()}
    where = f"{TEXELS} x {TEXELS}, {covered:,} covered texels"
    bilateral = seconds["bilateral"] / TEXELS**2
    rows = [Row("cv2.bilateralFilter(d = 7, float32), per texel", f"{1e6 * bilateral:.3f} us")]
    for kind, goal in (("plain", 3.5), ("regularised", None)):
        each = seconds[kind] / covered
        what = f"{where}: {kind} iteration, 7 x 7"
        rows.append(Row(f"{what}, per covered texel", f"{1e6 * each:.3f} us"))
        ratio = each / bilateral
        reported = f"{what}, in bilateral passes", f"{ratio:.2f}"
        rows.append(Row(*reported, f"<= {goal}", ratio <= goal) if goal else Row(*reported))
    ratio = seconds["set-up"] / seconds["plain"]
    value = f"{seconds['set-up']:.3f} s, {ratio:.2f} plain iterations"
    return [*rows, Row(f"{where}: set-up", value, "<= 1 iteration", ratio <= 1)]


def stage_seconds(source, guided):
    """Return the CPU seconds that it takes to make the manifold of a model's texels, without decoding images, and
    those of one iteration.
    """
    # As the peer does, without restoring averages of clipped noise.
    settings = smoothing(1, 1.4, guided, clipping="keep")
    surface = open_document(str(source)).textured("baseColor")
    marks = [time.process_time()]
    for texture in surface.textures:
        read_image(texture.data, texture.name)
    marks.append(time.process_time())
    plan = TextureLayer.read(surface, "baseColor", settings).plan()
    marks.append(time.process_time())
    smooth_in_place(plan)
    decoding, setup, iteration = np.diff([*marks, time.process_time()])
    return setup - decoding, iteration


def memory_rows(models=()):
    """Measure by how much the peak memory of a process grows with the texels that a surface covers."""
    with tempfile.TemporaryDirectory() as folder:
        runs = {}
        for size in (128, TEXELS):
            source = Path(folder) / f"{size}.glb"
            scene = texture_scene.torus(size)
            texture_files.write_glb(source, scene, scene.noisy)
            runs[size] = whole_job(source, folder)
        least, (_, _, seconds) = runs[128], runs[TEXELS]
        what = f"{TEXELS} x {TEXELS}, a process for the whole job"
        rows = [growth_row(what, least, runs[TEXELS]), Row(f"{what}: wall", f"{seconds:.2f} s")]
        for model in models:
            try:
                rows.append(growth_row(model.name, least, whole_job(model, folder)))
            except subprocess.CalledProcessError:
                print(f"passed over: {model.name}", file=sys.stderr)
    return rows


def growth_row(what, least, run):
    """Return the row of how much more memory a run took than one on few texels."""
    each = (run[0] - least[0]) / (run[1] - least[1])
    return Row(f"{what}: peak memory by covered texel", f"{each:.0f} bytes", "< 150 bytes", each < 150)


def whole_job(source, folder):
    """Smooth the textures of a model in a process of its own; return its peak memory, covered texels and seconds."""
    target, report = Path(folder) / f"smooth{source.suffix}", Path(folder) / "report.json"
    command = [*SMOOTH, source, target, "-n", "2", "--overwrite"]
    command += ["--on", "texture", "--quiet", "--beta", str(1.4 / SIGMA), "--report", report]
    start = time.perf_counter()
    subprocess.run(command, check=True, cwd=ROOT)
    seconds = time.perf_counter() - start
    reported = json.loads(report.read_text())
    return reported["peak_memory"], sum(slot["counts"]["covered"] for slot in reported["textures"]), seconds
