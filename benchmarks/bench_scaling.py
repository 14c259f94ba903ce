"""How time and memory of `beltrami smooth` grow with the number of samples: vertices of PLY files, texels of GLB files.

``--most N`` is up to how many samples (default: 10,000,000, for which the benchmark itself takes some 16 GB);
``--plot FILE`` draws them; ``--json FILE`` writes the rows. One thread, five iterations, parameters given.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import scene as scenes
import texture_files
import texture_scene
from rich.console import Console
from rich.table import Table

COUNTS = [10_000, 31_623, 100_000, 316_228, 1_000_000, 3_162_278, 10_000_000]
SETTINGS = ["-n", "5", "-t", "2.4", "--beta", "17", "--beta-growth", "1.5", "--metric-steps", "1"]


def main():
    """Smooth files of every size, print and draw what they cost."""
    parser = argparse.ArgumentParser(description="Benchmark how cost grows with size.")
    parser.add_argument("--most", type=int, default=COUNTS[-1], metavar="N", help=f"default: {COUNTS[-1]}")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw them there")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    options = parser.parse_args()
    console = Console(stderr=True)
    rows = []
    for kind, write in (("vertices", write_vertices), ("texels", write_texture)):
        for count in COUNTS:
            if count > options.most:
                continue
            with console.status(f"Smooth {count:,} {kind}"), tempfile.TemporaryDirectory() as folder:
                rows.append((kind, *smooth(write(Path(folder), count), Path(folder))))
    table = Table("", "samples", "CPU", "each", "peak memory", "each")
    for kind, samples, seconds, memory in rows:
        each = f"{1e6 * seconds / samples:.2f} us", f"{memory / samples:.0f} bytes"
        table.add_row(kind, f"{samples:,}", f"{seconds:.2f} s", each[0], f"{memory / 1e6:.0f} MB", each[1])
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")
    if options.plot:
        draw(rows, options.plot)


def write_vertices(folder, count):
    """Write a torus with noisy vertex colours."""
    rings = math.isqrt(int(2.56 * count))
    scenes.write_ply(folder / "noisy.ply", scenes.torus(rings, count // rings))
    return folder / "noisy.ply"


def write_texture(folder, count):
    """Write a torus with a noisy texture."""
    scene = texture_scene.torus(math.isqrt(count))
    texture_files.write_glb(folder / "noisy.glb", scene, scene.noisy)
    return folder / "noisy.glb"


def smooth(source, folder):
    """Return how many samples a file has, and the CPU seconds and the peak memory of the whole command."""
    target, report = folder / f"smooth{source.suffix}", folder / "report.json"
    # The start of the program counts too.
    measured = (
        "import os, resource, sys; code = os.spawnv(os.P_WAIT, sys.argv[1], sys.argv[1:]); "
        "used = resource.getrusage(resource.RUSAGE_CHILDREN); print(used.ru_utime + used.ru_stime); sys.exit(code)"
    )
    command = [sys.executable, "-c", measured, *scenes.SMOOTH, source, target]
    command += [*SETTINGS, "--threads", "1", "--quiet", "--report", report]
    run = subprocess.run(command, check=True, cwd=scenes.ROOT, capture_output=True, text=True)
    reported = json.loads(report.read_text())
    samples = sum(slot["counts"]["covered"] for slot in reported["textures"])
    if reported["vertices"] is not None:
        samples = reported["vertices"]["counts"]["vertices"]
    return samples, float(run.stdout), reported["peak_memory"]


def draw(rows, path):
    """Draw time and memory over the number of samples, with lines of proportion."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for kind, marker in (("vertices", "o"), ("texels", "s")):
        samples, seconds, memory = zip(*(row[1:] for row in rows if row[0] == kind), strict=True)
        left.loglog(samples, seconds, marker=marker, label=kind)
        right.loglog(samples, [size / 1e6 for size in memory], marker=marker, label=kind)
        for axes, last in ((left, seconds[-1]), (right, memory[-1] / 1e6)):
            axes.loglog(
                samples, [last * count / samples[-1] for count in samples], color="0.7", lw=1, zorder=0
            )
    left.set(title="CPU seconds, five iterations, one thread", xlabel="samples")
    right.set(title="peak memory, MB", xlabel="samples")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
