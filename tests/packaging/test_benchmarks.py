"""Benchmarks that pages and comments name are there, and all can be loaded with the package as it is."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "benchmarks"
SCENARIOS = sorted(path.stem for path in BENCHMARKS.glob("bench_*.py") if path.stem != "bench_blender")


def test_named_benchmarks_exist():
    folders = [ROOT / name for name in ("docs", "beltrami_cli", "noise_model", "benchmarks")]
    files = [path for folder in folders for path in folder.rglob("*") if path.suffix in (".md", ".py")]
    text = "\n".join(
        path.read_text(encoding="utf-8") for path in [ROOT / "Makefile", ROOT / "README.md", *files]
    )
    named = set(re.findall(r"\bbench_\w+(?=\.py)", text))
    assert len(named) > 5
    assert named <= {path.stem for path in BENCHMARKS.glob("*.py")}


def test_each_scenario_is_explained_by_the_harness():
    text = (BENCHMARKS / "harness.py").read_text(encoding="utf-8").split('"""')[1]
    assert {name.removeprefix("bench_") for name in SCENARIOS} <= set(re.findall(r"`(\w+)`", text))


@pytest.mark.slow  # about a second
def test_all_scenarios_load():
    """Other programs are imported where they are used, so that a scenario says which one is missing."""
    loaded = f"import {', '.join(SCENARIOS)}"
    subprocess.run([sys.executable, "-c", loaded], cwd=BENCHMARKS, check=True)


@pytest.mark.slow  # about a second
def test_a_program_that_is_not_installed_is_named_in_one_line():
    command = [sys.executable, "-c", "import peers; peers.needed('no_such_peer')"]
    run = subprocess.run(command, cwd=BENCHMARKS, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (1, "no_such_peer: not installed\n")


@pytest.mark.slow  # about a second each
@pytest.mark.parametrize("name", ["clean", "outliers", "regret"])
def test_folders_without_images_are_refused_in_one_line(name, tmp_path):
    command = [sys.executable, f"bench_{name}.py", tmp_path]
    run = subprocess.run(command, cwd=BENCHMARKS, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert len(run.stderr.splitlines()) == 1
