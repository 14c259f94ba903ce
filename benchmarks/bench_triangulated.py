"""Time and quality of the kernel on triangle meshes, beside other programs: ``make bench``.

``--json FILE`` writes the rows; ``--quick`` uses smaller meshes, to see that everything runs.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import peers
import scene as scenes
import timing
from rich.console import Console
from rich.table import Table

from beltrami_cli import _native

BETA = 5.0
SAMPLES = (20, 50)
MOST_ITERATIONS = 30
COLOUR_SMOOTHING = {
    "PyMeshLab Laplacian": peers.pymeshlab_smoothing,
    "Open3D Laplacian": partial(peers.open3d_smoothing, "laplacian"),
    "Open3D simple": partial(peers.open3d_smoothing, "simple"),
}
OURS = {
    "beltrami, beta 13, t 1.3, 10 iterations": {"beta": 13.0, "t": 1.3, "iterations": 10, "metric_steps": 0},
    "beltrami, defaults": {},
}
GOAL_MICROSECONDS = {20: 3.5, 50: 8.5}
GOAL_SEGMENTS = {20: 0.30, 50: 0.50}


@dataclass(frozen=True)
class Row:
    """One measurement; `goal` is what it should reach, and `met` whether it does (None: there is none)."""

    what: str
    value: str
    goal: str = ""
    met: bool | None = None


def main():
    """Run all benchmarks; print a table, write JSON."""
    parser = argparse.ArgumentParser(description="Benchmark the kernel on triangle meshes.")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    parser.add_argument("--quick", action="store_true", help="smaller meshes, for a look")
    parser.add_argument("--repeats", type=int, default=5, help="pairs of runs per time (default: 5)")
    parser.add_argument(
        "--gdist-python",
        default=sys.executable,
        metavar="PYTHON",
        help="interpreter that has gdist (NumPy 1)",
    )
    options = parser.parse_args()
    console = Console(stderr=True)
    rows = []
    for measure in (kernel_rows, solver_rows, gdist_rows, quality_rows, million_rows):
        with console.status(measure.__doc__.splitlines()[0]):
            rows += measure(options)
    show(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def kernel_rows(options):
    """Measure the time of an iteration, with one thread and with two."""
    sphere = scenes.icosphere(5 if options.quick else 7)
    count, rows = len(sphere.positions), []
    for samples in SAMPLES:
        t = timing.time_step_for(samples, sphere, BETA)
        settings = {"t": t, "beta": BETA}
        seconds, held = timing.iteration_seconds(sphere, options.repeats, threads=1, **settings)
        each, goal = 1e6 * seconds / count, GOAL_MICROSECONDS[samples]
        what = f"{count:,} vertices, {held:.1f} samples a kernel (t {t:.2f}, beta {BETA:g})"
        rows.append(
            Row(f"{what}: CPU per vertex and iteration", f"{each:.2f} us", f"<= {goal} us", each <= goal)
        )
        gain = timing.thread_gain(sphere, options.repeats, **settings)
        rows.append(Row(f"{what}: two threads against one, wall", f"{gain:.2f} x", ">= 1.8 x", gain >= 1.8))
    return rows


def solver_rows(options):
    """Measure an iteration along segments beside fast marching, in pairs, the update of the metric included."""
    sphere, rows = scenes.icosphere(5 if options.quick else 7), []
    order = _native.morton_order(sphere.positions)
    faces = np.argsort(order).astype(np.int32)[sphere.faces]
    positions = sphere.positions[order] / scenes.surfaces.mean_edge_length(sphere.positions, sphere.faces)
    solvers = [
        solver(faces, len(order)) for solver in (_native.TriangulatedManifold, _native.SegmentManifold)
    ]
    for samples, goal in GOAL_SEGMENTS.items():
        t = timing.time_step_for(samples, sphere, BETA)
        marching, segments = (
            1e6
            * timing.solver_seconds(solver, positions, sphere.noisy[order], BETA, t, options.repeats)
            / len(order)
            for solver in solvers
        )
        what = (
            f"{len(order):,} vertices, {samples} samples a kernel: along segments, per vertex and iteration"
        )
        reported = f"{segments:.2f} us, {marching / segments:.1f} x faster than fast marching"
        rows.append(Row(what, reported, f"<= {goal} us", segments <= goal))
    return rows


def gdist_rows(options):
    """Measure local distances per source beside gdist's exact ones, on the surface alone (beta 0)."""
    sphere = scenes.icosphere(5 if options.quick else 7)
    rows = []
    for samples in SAMPLES:
        t = timing.time_step_for(samples, sphere, 0.0)
        seconds, held = timing.iteration_seconds(sphere, options.repeats, threads=1, t=t, beta=0.0)
        each = seconds / len(sphere.positions)
        what = (
            f"gdist local distances, the same radius, {held:.1f} samples (ours {1e6 * each:.2f} us a source)"
        )
        spacing = scenes.surfaces.mean_edge_length(sphere.positions, sphere.faces)
        radius = spacing * (-4 * t * np.log(0.01)) ** 0.5
        try:
            theirs, _ = peers.gdist_distances(sphere, radius, 4000, options.gdist_python)
        except peers.PeerError as missing:
            rows.append(Row(what, str(missing)))
            continue
        ratio = theirs / each
        rows.append(Row(what, f"{1e6 * theirs:.0f} us, {ratio:.0f} x slower", ">= 25 x", ratio >= 25))
    return rows


def quality_rows(options):
    """Measure the PSNR beside the best that other colour smoothing reaches when it is tuned on the truth."""
    rows = []
    for subdivisions in (5,) if options.quick else (6, 7):
        rows += pattern_rows(scenes.icosphere(subdivisions, scenes.chequer), "chequer", 14.0)
    return rows + pattern_rows(
        scenes.icosphere(5 if options.quick else 7, scenes.patches), "random patches", None
    )


def pattern_rows(sphere, pattern, gain):
    """Measure the PSNR on one scene; `gain` is how many dB above the best peer the kernel should reach."""
    where = f"PSNR, {len(sphere.positions):,} vertices, {pattern}"
    rows, best = [Row(f"{where}: noisy", f"{scenes.psnr(sphere.clean, sphere.noisy):.1f} dB")], 0.0
    for name, smooth in COLOUR_SMOOTHING.items():
        try:
            reached, iterations = smooth(sphere, MOST_ITERATIONS)
        except peers.PeerError as missing:
            rows.append(Row(f"{where}: {name}", str(missing)))
            continue
        best = max(best, reached)
        rows.append(
            Row(f"{where}: {name}, best of {MOST_ITERATIONS}", f"{reached:.1f} dB ({iterations} iterations)")
        )
    for name, settings in OURS.items():
        ours = scenes.psnr(sphere.clean, timing.smooth(sphere, **settings).colours)
        value = f"{ours:.1f} dB" + (f" ({ours - best:+.1f})" if best else "")
        if gain and best and settings:
            rows.append(Row(f"{where}: {name}", value, f">= +{gain:g} dB", ours >= best + gain))
        else:
            rows.append(Row(f"{where}: {name}", value))
    return rows


def million_rows(options):
    """Measure memory and time of a file with a million vertices, ten iterations, in a process of its own."""
    torus = scenes.torus(*((200, 100) if options.quick else (1600, 625)))
    with tempfile.TemporaryDirectory() as folder:
        source, target, report = (Path(folder) / name for name in ("noisy.ply", "smooth.ply", "report.json"))
        scenes.write_ply(source, torus)
        command = [*scenes.SMOOTH, source, target, "-n", "10", "-t", "0.7"]
        command += ["--beta", str(BETA), "--quiet", "--report", report]
        subprocess.run(command, check=True, cwd=scenes.ROOT)
        reported = json.loads(report.read_text())
    memory, held = reported["peak_memory"] / 1e9, reported["vertices"]["counts"]["samples_per_kernel"]
    what = f"PLY file of {len(torus.positions):,} vertices, 10 iterations, {held:.1f} samples a kernel"
    rows = [Row(f"{what}: peak memory", f"{memory:.2f} GB", "< 1 GB", memory < 1)]
    for stage, times in reported["stages"].items():
        rows.append(Row(f"{what}: {stage}", f"{times['cpu']:.2f} s CPU, {times['wall']:.2f} s wall"))
    return rows


def show(rows):
    """Print the rows as a table on stdout."""
    table = Table("what", "measured", "goal", "")
    for row in rows:
        mark = "" if row.met is None else "[green]met[/]" if row.met else "[red]missed[/]"
        table.add_row(row.what, row.value, row.goal, mark)
    Console(width=None if sys.stdout.isatty() else 160).print(table)


if __name__ == "__main__":
    main()
