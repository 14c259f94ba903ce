"""Measure the processor time of each phase of progress on two textures: `_SECONDS` of jobs/progress.py.

``--small N`` and ``--large N`` are their sides in texels. Time that does not grow with the number of texels is a column
of its own.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import textures
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import phase_of
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.view.report import report_file
from harness import arguments, show

CORNERS = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], float)


class PhaseTimes:  # a progress callback
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._label, self._last = "", time.process_time()

    def __call__(self, label: str, done: float, total: float) -> None:
        now = time.process_time()
        if self._label:
            self.seconds[self._label] = self.seconds.get(self._label, 0.0) + now - self._last
        self._label, self._last = phase_of(label), now


def write(path: Path, side: int, noise: float) -> Path:
    at = np.arange(side) / side
    plain = 0.5 + 0.3 * np.sin(40 * at)[:, None] * np.sin(30 * at)[None, :]
    noisy = plain[..., None] + np.random.default_rng(1).normal(0, noise, (side, side, 3))
    square = textures.TexturedScene(path.stem, CORNERS, CORNERS[..., :2], np.zeros(2, int), [noisy], [])
    textures.write_obj(path, square, [np.rint(255 * np.clip(noisy, 0, 1))])
    return path


def measured(side: int) -> dict[str, dict[str, float]]:
    with tempfile.TemporaryDirectory() as name:
        folder, found = Path(name), {}
        clean, noisy = write(folder / "clean.obj", side, 0.0), write(folder / "noisy.obj", side, 0.04)
        commands: dict[str, Callable[[Job], object]] = {
            "info": lambda job: inspect_file(noisy, job=job),
            "smooth": lambda job: smooth_file(noisy, folder / "out.obj", job=job),
            "compare": lambda job: compare_files(clean, noisy, job=job),
            "report": lambda job: report_file(str(clean), str(noisy), str(folder / "x.html"), job=job),
        }
        for command, run in commands.items():
            times = PhaseTimes()
            run(Job(progress=times))
            times("", 1, 1)
            found[command] = times.seconds
        return found


def main() -> None:
    options = arguments(__doc__, small=256, large=2048)
    small, large = measured(options.small), measured(options.large)
    rows = []
    for command, phases in large.items():
        for phase, seconds in phases.items():
            least = small[command].get(phase, 0.0)
            each = (seconds - least) / (options.large**2 - options.small**2)
            rows.append((command, phase, max(0.0, least - each * options.small**2), 1e6 * each))
    show(rows, options, ("command", "phase", "seconds", "us a sample"))


if __name__ == "__main__":
    main()
