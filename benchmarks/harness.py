"""Shared by the scenarios: paths, options, tables, and running the command in its own process.

``python benchmarks/bench_*.py`` runs a scenario; each prints a table and, with ``--json FILE``, writes its rows.
Inputs are in `vertices.py`, `textures.py` (texels) and `pixels.py` (images and their noise), other programs
in `peers.py`. The scenarios measure what tests cannot:

- `regret`: the PSNR lost because the noise is estimated; `clean`: changes of images without noise.
- `patches`, `camera_noise`: quality against other tools, for white noise on surfaces and noise that neighbours share.
- `triangulated`, `textures`, `scaling`: time and memory, of the solvers, of an iteration, of the whole command.
- `geometry`, `levelling`: how well smoothing positions and removing exposure steps restores a known truth.
- `outliers`, `progress`: constants of the code whose comments name these scenarios.
- `strengths`: whether gentle, normal and strong differ on every image.
- `blender`: a bake in Blender itself (``make test-blender``).
"""

import json
import os
import subprocess
import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "sample_data"
sys.path.insert(0, str(ROOT / "tests"))  # for oracles and scenes

SIGMA = 20 / 255  # noise of the generated scenes

Row = tuple[Any, ...]

# Prints the processor time of a command, including its start.
_MEASURED = (
    "import os, resource, sys; code = os.spawnv(os.P_WAIT, sys.argv[1], sys.argv[1:]); "
    "used = resource.getrusage(resource.RUSAGE_CHILDREN); print(used.ru_utime + used.ru_stime); sys.exit(code)"
)


def arguments(doc: str, paths: str = "", *, required: bool = False, **described: Any) -> Namespace:
    """Parse the command line: a list of paths, and flags or values with their defaults; `doc` describes them."""
    parser = ArgumentParser(description=doc, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    if paths:
        parser.add_argument(paths, nargs="+" if required else "*", type=Path)
    for name, default in described.items():
        option: dict[str, Any] = {"type": type(default), "default": default}
        if default is False:
            option = {"action": "store_true"}
        parser.add_argument(f"--{name.replace('_', '-')}", **option)
    return parser.parse_args()


def show(rows: Sequence[Row], options: Namespace, header: Sequence[str] = ("what", "measured")) -> None:
    """Print rows as a Markdown table; with ``--json`` also write them."""
    print(f"| {' | '.join(header)} |\n|{'---|' * len(header)}")
    print(*(f"| {' | '.join(map(as_text, each))} |" for each in rows), sep="\n", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def as_text(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def smooth_apart(source: Path, target: Path, *words: str) -> tuple[dict[str, Any], float]:
    """Run ``beltrami smooth`` in its own process; return its report, and its processor time in seconds."""
    report = target.with_name("report.json")
    files = source, target, "--report", report
    command = sys.executable, "-P", "-m", "beltrami_cli", "smooth", *map(str, files), "--quiet", "--overwrite"
    measured = [sys.executable, "-c", _MEASURED, *command, *words]
    run = subprocess.run(measured, check=True, cwd=ROOT, capture_output=True, text=True)
    return json.loads(report.read_text()), float(run.stdout)


def extra_models(suffixes: Collection[str]) -> list[Path]:
    """Return the models of the folder that the environment variable BELTRAMI_EXTRA_MESHES names."""
    extra = os.environ.get("BELTRAMI_EXTRA_MESHES")
    return sorted(path for path in Path(extra).rglob("*") if path.suffix in suffixes) if extra else []


def rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def psnr(colours: ArrayLike, truth: ArrayLike, counted: Any = ...) -> float:
    """Return the peak signal-to-noise ratio in dB, which may be infinite; the peak is 1."""
    error = np.asarray(colours, float)[counted] - np.asarray(truth, float)[counted]
    with np.errstate(divide="ignore"):
        return float(-10 * np.log10(np.mean(np.square(error))))
