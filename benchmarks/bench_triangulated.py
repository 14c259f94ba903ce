"""Measure time of an iteration on triangle meshes by both solvers, and compare quality: ``make bench``.

Times are CPU time of one thread per vertex and iteration, medians of ``--repeats N`` pairs of runs. ``--level 5`` uses
small meshes, for a quick check that everything runs.
"""

import math
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import beltrami_cli
import peers
import vertices
from beltrami_cli import _native
from beltrami_cli.arrays import Array
from harness import Row, arguments, psnr, show
from oracles.surfaces import mean_edge_length
from vertices import Scene

BETA = 5.0  # of the runs that are timed
SAMPLES = (20, 50)  # per kernel
MAX_ITERATIONS = 30  # of other programs; the best one counts
COLOUR_SMOOTHING: dict[str, Callable[[Scene, int], tuple[float, int]]] = {
    "PyMeshLab Laplacian": peers.pymeshlab_smoothing,
    "Open3D Laplacian": partial(peers.open3d_smoothing, "laplacian"),
    "Open3D simple": partial(peers.open3d_smoothing, "simple"),
}
OURS: dict[str, dict[str, Any]] = {
    "beltrami, beta 13, t 1.3, 10 iterations": {"beta": 13.0, "t": 1.3, "iterations": 10, "metric_steps": 0},
    "beltrami, defaults": {},
}


def main() -> None:
    options = arguments(__doc__, level=7, repeats=5)
    sphere = vertices.icosphere(options.level)
    rows = [row for samples in SAMPLES for row in time_rows(sphere, samples, options.repeats)]
    for pattern in (vertices.chequer, vertices.mosaic):
        rows += quality_rows(vertices.icosphere(options.level, pattern), pattern.__name__)
    show(rows, options)


def time_rows(sphere: Scene, samples: int, repeats: int) -> Iterator[Row]:
    """Measure an iteration of the defaults, with two threads, and of each solver with the update of the metric."""
    count, t = len(sphere.positions), time_step_for(samples, sphere)
    what = f"{count:,} vertices, {samples} samples a kernel"
    each = [1e6 * iteration_seconds(sphere, t, threads, clock, repeats) / count for threads, clock in (
        (1, time.process_time), (1, time.perf_counter), (2, time.perf_counter))]  # fmt: skip
    yield f"{what}: CPU per vertex and iteration", f"{each[0]:.2f} us"
    yield f"{what}: two threads against one, wall", f"{each[1] / each[2]:.2f} x"
    order = _native.morton_order(sphere.positions)
    faces = np.argsort(order).astype(np.int32)[sphere.faces]
    positions = sphere.positions[order] / mean_edge_length(sphere.positions, sphere.faces)
    marching, segments = (
        1e6 * solver_seconds(solver(faces, count), positions, sphere.noisy[order], t, repeats) / count
        for solver in (_native.TriangulatedManifold, _native.SegmentManifold)
    )
    yield f"{what}: heap march; segments", f"{marching:.2f} us; {segments:.2f} us"


def smooth(scene: Scene, **options: Any) -> beltrami_cli.SmoothResult:
    """Run `beltrami_cli.smooth` on the noisy scene; colours are taken as plain numbers."""
    return beltrami_cli.smooth(scene.positions, scene.faces, scene.noisy, space="data", **options)


def time_step_for(samples: int, scene: Scene) -> float:
    """Return the t for which kernels have about this many samples, which are almost proportional to t."""
    t = samples / 34
    for _ in range(4):
        t *= samples / smooth(scene, metric_steps=0, iterations=1, t=t, beta=BETA).samples_per_kernel
    return t


def iteration_seconds(
    scene: Scene, t: float, threads: int, clock: Callable[[], float], repeats: int
) -> float:
    """Return the median difference of the times of alternating runs with one iteration and with none."""
    differences = []
    for _ in range(repeats):
        times = []
        for iterations in (0, 1):
            start = clock()
            smooth(scene, metric_steps=0, iterations=iterations, threads=threads, t=t, beta=BETA)
            times.append(clock() - start)
        differences.append(times[1] - times[0])
    return statistics.median(differences)


def solver_seconds(manifold: Any, positions: Array, colours: Array, t: float, repeats: int) -> float:
    """Return the shortest CPU time of an iteration of a solver, without its work once per mesh."""
    shortest, radius = math.inf, math.sqrt(-4 * t * math.log(0.01))
    for _ in range(repeats + 1):  # regions are found in the first
        start = time.process_time()
        manifold.update_metric(positions, colours, BETA, None, 1)
        manifold.smooth(colours, None, t, radius, 2000, 1, None)
        shortest = min(shortest, time.process_time() - start)
    return shortest


def quality_rows(sphere: Scene, pattern: str) -> Iterator[Row]:
    """Compare the PSNR with the best of other colour smoothing, which is tuned on the truth."""
    where = f"PSNR, {len(sphere.positions):,} vertices, {pattern}"
    yield f"{where}: noisy", f"{psnr(sphere.noisy, sphere.clean):.1f} dB"
    for name, run in COLOUR_SMOOTHING.items():
        try:
            reached, iterations = run(sphere, MAX_ITERATIONS)
        except peers.PeerError as missing:
            yield f"{where}: {name}", str(missing)
            continue
        yield f"{where}: {name}, best of {MAX_ITERATIONS}", f"{reached:.1f} dB ({iterations} iterations)"
    for name, settings in OURS.items():
        yield f"{where}: {name}", f"{psnr(smooth(sphere, **settings).colours, sphere.clean):.1f} dB"


if __name__ == "__main__":
    main()
