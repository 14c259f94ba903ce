"""The processor time of each phase of progress, on a small and a large texture: `_SECONDS` of jobs/progress.py."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import phase_of
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.view.report import report_file

SIDES = (256, 2048) if len(sys.argv) < 2 else tuple(map(int, sys.argv[1].split(",")))
SQUARE = """mtllib {0}.mtl
usemtl m
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""


class Times:
    """A progress callback that sums the processor time of phases."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._label, self._last = "", time.process_time()

    def __call__(self, label: str, done: int, total: int) -> None:
        now = time.process_time()
        if self._label:
            self.seconds[self._label] = self.seconds.get(self._label, 0.0) + now - self._last
        self._label, self._last = phase_of(label), now


def write(folder: Path, name: str, side: int, noise: float) -> Path:
    """Write a square with one texture of stripes."""
    at = np.arange(side) / side
    plain = 0.5 + 0.3 * np.sin(40 * at)[:, None] * np.sin(30 * at)[None, :]
    noisy = plain[..., None] + np.random.default_rng(1).normal(0, noise, (side, side, 3))
    pixels = np.rint(255 * np.clip(noisy, 0, 1)).astype(np.uint8)
    picture = new_picture(pixels, f"{name}.png")
    (folder / f"{name}.png").write_bytes(write_image(picture, pixels, suffix=".png").data)
    (folder / f"{name}.mtl").write_text(f"newmtl m\nmap_Kd {name}.png\n")
    (folder / f"{name}.obj").write_text(SQUARE.format(name))
    return folder / f"{name}.obj"


def measured(side: int) -> dict[str, dict[str, float]]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clean, noisy = write(folder, "clean", side, 0.0), write(folder, "noisy", side, 0.04)
        found = {}
        for command, run in (
            ("info", lambda times: inspect_file(noisy, progress=times)),
            ("smooth", lambda times: smooth_file(noisy, folder / "out.obj", job=Job(progress=times))),
            ("compare", lambda times: compare_files(clean, noisy, job=Job(progress=times))),
            (
                "report",
                lambda times: report_file(
                    str(clean), str(noisy), str(folder / "x.html"), job=Job(progress=times)
                ),
            ),
        ):
            times = Times()
            run(times)
            times("", 1, 1)
            found[command] = times.seconds
        return found


small, large = (measured(side) for side in SIDES)
print(f"{'':10} {'phase':22} {'seconds':>8} {'us a sample':>12}")
for command, phases in large.items():
    for phase, seconds in phases.items():
        each = (seconds - small[command].get(phase, 0.0)) / (SIDES[1] ** 2 - SIDES[0] ** 2)
        once = max(0.0, small[command].get(phase, 0.0) - each * SIDES[0] ** 2)
        print(f"{command:10} {phase:22} {once:8.2f} {1e6 * each:12.2f}")
