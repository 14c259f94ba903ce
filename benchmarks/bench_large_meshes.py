"""Time and memory of `beltrami smooth` on large PLY files, in a good order and in a random one: ``make bench``.

``--vertices N`` is how many (default: 1,000,000); ``--json FILE`` writes the rows.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import scene as scenes
from rich.console import Console
from rich.table import Table

MOST_FOR_ORDER = 1.15
MOST_BYTES = 24e9 / 10e6


def main():
    """Smooth both files, print what they cost."""
    parser = argparse.ArgumentParser(description="Benchmark large files of vertex colours.")
    parser.add_argument("--vertices", type=int, default=1_000_000, metavar="N", help="default: 1000000")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="default: 1")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    options = parser.parse_args()
    rings = math.isqrt(int(2.56 * options.vertices))
    torus = scenes.torus(rings, options.vertices // rings)
    console = Console(stderr=True)
    rows, seconds = [], []
    for name, scene in (("sorted", lambda: torus), ("in random order", lambda: shuffled(torus))):
        with console.status(f"Smooth {options.vertices:,} vertices, {name}"):
            reported = smooth_file(scene(), options.threads)
        count, memory = reported["vertices"]["counts"]["vertices"], reported["peak_memory"]
        cpu = {stage: times["cpu"] for stage, times in reported["stages"].items()}
        seconds.append(sum(cpu.values()))
        stages = ", ".join(f"{stage} {spent:.2f}" for stage, spent in cpu.items())
        rows.append((f"{count:,} vertices, {name}: CPU", f"{seconds[-1]:.1f} s ({stages})", ""))
        rows.append((f"{name}: peak memory, bytes a vertex", f"{memory / count:.0f}", f"<= {MOST_BYTES:.0f}"))
    rows.append(
        ("random order against sorted, CPU", f"{seconds[1] / seconds[0]:.2f} x", f"<= {MOST_FOR_ORDER} x")
    )
    table = Table("what", "measured", "goal")
    for row in rows:
        table.add_row(*row)
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


def shuffled(scene):
    """Return the scene with its vertices and its faces in random order."""
    random = np.random.default_rng(5)
    order = random.permutation(len(scene.positions)).astype(np.int32)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=np.int32)
    faces = rank[scene.faces[random.permutation(len(scene.faces))]]
    return replace(scene, positions=scene.positions[order], faces=faces, noisy=scene.noisy[order])


def smooth_file(scene, threads):
    """Smooth the scene as a file by the command with its defaults; return the report."""
    with tempfile.TemporaryDirectory() as folder:
        source, target, report = (Path(folder) / name for name in ("noisy.ply", "smooth.ply", "report.json"))
        scenes.write_ply(source, scene)
        command = [*scenes.SMOOTH, source, target]
        command += ["--threads", str(threads), "--quiet", "--report", report]
        subprocess.run(command, check=True, cwd=scenes.ROOT)
        return json.loads(report.read_text())


if __name__ == "__main__":
    main()
