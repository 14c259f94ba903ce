"""Measure time and memory of `beltrami smooth` by the number of samples: vertices of PLY files, texels of OBJ files.

``--least N`` and ``--most N`` limit the number of samples (10,000,000 take about 16 GB). ``--plot FILE`` draws a plot.
``--shuffled`` puts vertices and faces in random order. ``--chosen`` lets the program choose parameters; otherwise five
iterations are run. All runs use one thread.
"""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import textures
import vertices
from harness import arguments, show, smooth_apart

COUNTS = [10_000, 31_623, 100_000, 316_228, 1_000_000, 3_162_278, 10_000_000]
# Fixed parameters, so that the cost of a sample does not depend on a choice.
GIVEN = ["-n", "5", "-t", "2.4", "--beta", "17", "--beta-growth", "1.5", "--metric-steps", "1"]


def main() -> None:
    options = arguments(__doc__, most=COUNTS[-1], least=COUNTS[0], plot="", shuffled=False, chosen=False)
    counts = [count for count in COUNTS if options.least <= count <= options.most]
    costs = []
    for kind, write in (("vertices", write_vertices), ("texels", write_texture)):
        for count in counts if kind == "vertices" or not options.shuffled else []:
            with tempfile.TemporaryDirectory() as folder:
                source = write(Path(folder), count, shuffle=options.shuffled)
                costs.append((kind, *cost(source, [] if options.chosen else GIVEN)))
    rows = [
        (kind, f"{n:,}", f"{cpu:.2f} s", f"{1e6 * cpu / n:.2f} us", f"{memory / 1e6:.0f} MB", f"{memory / n:.0f} bytes")
        for kind, n, cpu, memory in costs
    ]  # fmt: skip
    show(rows, options, ("", "samples", "CPU", "each", "peak memory", "each"))
    if options.plot:
        draw(costs, options.plot)


def write_vertices(folder: Path, count: int, *, shuffle: bool) -> Path:
    rings = math.isqrt(int(2.56 * count))
    scene = vertices.torus(rings, count // rings)
    if shuffle:
        random = np.random.default_rng(5)
        order = random.permutation(len(scene.positions)).astype(np.int32)
        rank = np.argsort(order).astype(np.int32)
        faces = rank[scene.faces[random.permutation(len(scene.faces))]]
        scene = replace(scene, positions=scene.positions[order], faces=faces, noisy=scene.noisy[order])
    vertices.write_ply(folder / "noisy.ply", scene)
    return folder / "noisy.ply"


def write_texture(folder: Path, count: int, *, shuffle: bool) -> Path:
    del shuffle
    scene = textures.torus(math.isqrt(count))
    textures.write_obj(folder / "noisy.obj", scene, scene.noisy)
    return folder / "noisy.obj"


def cost(source: Path, settings: list[str]) -> tuple[int, float, int]:
    """Return the number of samples of a file, and CPU seconds and peak memory of the whole command."""
    target = source.with_stem("smooth")
    report, seconds = smooth_apart(source, target, *settings, "--threads", "1")
    samples = sum(slot["counts"]["covered"] for slot in report["textures"])
    if report["vertices"] is not None:
        samples = report["vertices"]["counts"]["vertices"]
    return samples, seconds, report["peak_memory"]


def draw(costs: list[tuple[str, int, float, int]], path: str) -> None:
    """Plot time and memory against the number of samples, with lines of proportional growth."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for kind, marker in (("vertices", "o"), ("texels", "s")):
        samples, seconds, memory = zip(*(each[1:] for each in costs if each[0] == kind), strict=True)
        for axes, values in ((left, seconds), (right, [size / 1e6 for size in memory])):
            axes.loglog(samples, values, marker=marker, label=kind)
            line = [values[-1] * count / samples[-1] for count in samples]
            axes.loglog(samples, line, color="0.7", lw=1, zorder=0)
    left.set(title="CPU seconds, five iterations, one thread", xlabel="samples")
    right.set(title="peak memory, MB", xlabel="samples")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
