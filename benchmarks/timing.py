"""Times that a busy machine does not spoil: medians of differences between neighbouring runs."""

import math
import statistics
import time

import beltrami_cli


def iteration_seconds(scene, repeats, **options):
    """Return the CPU time of one kernel iteration on the noisy scene, and the samples that a kernel held.

    Every repeat runs the preparation alone (no iteration) and with one iteration right after it; the
    difference is the iteration. All iterations start from the same noisy colours.

    Parameters
    ----------
    scene : Scene
        What to smooth.
    repeats : int
        Pairs of runs; the median counts.
    **options
        For `beltrami_cli.smooth`.
    """
    differences, samples = [], 0.0
    for _ in range(repeats):
        times = []
        for iterations in (0, 1):
            start = time.process_time()
            result = smooth(scene, metric_steps=0, iterations=iterations, **options)
            times.append(time.process_time() - start)
        differences.append(times[1] - times[0])
        samples = result.samples_per_kernel
    return statistics.median(differences), samples


def solver_seconds(manifold, positions, colours, beta, t, repeats):
    """Return the CPU time of an iteration of a solver, without what it does once per mesh: the shortest counts."""
    shortest, radius = float("inf"), math.sqrt(-4 * t * math.log(0.01))
    for _ in range(repeats + 1):  # regions are found in the first
        start = time.process_time()
        manifold.update_metric(positions, colours, beta, None, 1)
        manifold.smooth(colours, None, t, radius, 2000, 1, None)
        shortest = min(shortest, time.process_time() - start)
    return shortest


def thread_gain(scene, repeats, **options):
    """Return how many times faster an iteration is with two threads than with one, by the clock on the wall.

    Wall time suffers from whatever else runs, and never gains, so that the shortest of all repeats counts.
    """
    shortest = {}
    for _ in range(repeats):
        for run in ((0, 1), (1, 1), (0, 2), (1, 2)):
            iterations, threads = run
            start = time.perf_counter()
            smooth(scene, metric_steps=0, iterations=iterations, threads=threads, **options)
            shortest[run] = min(time.perf_counter() - start, shortest.get(run, float("inf")))
    return (shortest[1, 1] - shortest[0, 1]) / (shortest[1, 2] - shortest[0, 2])


def smooth(scene, **options):
    """Run `beltrami_cli.smooth` on the noisy scene; colours are taken as plain numbers."""
    return beltrami_cli.smooth(scene.positions, scene.faces, scene.noisy, space="data", **options)


def time_step_for(samples, scene, beta):
    """Return the t for which kernels hold about this many samples on the noisy scene.

    Their number grows almost in proportion to t, so that a few steps of proportion find it.
    """
    t = samples / 34
    for _ in range(4):
        t *= samples / smooth(scene, metric_steps=0, iterations=1, t=t, beta=beta).samples_per_kernel
    return t
