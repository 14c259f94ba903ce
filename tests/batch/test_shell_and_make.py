"""What docs/batch.md shows for the shell and for make, run as it stands there."""

import gzip
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from cli.commands import COMMAND, SAMPLES
from hostile.textured_models import write_model

PAGE = (Path(__file__).parents[2] / "docs" / "batch.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("\n## From the shell, and with make\n")[2].partition("\n## ")[0]
[SHELL], [MAKEFILE] = (re.findall(rf"```{kind}\n(.*?)```", SECTION, re.DOTALL) for kind in ("sh", "make"))
# Variables of the environment make it quick; on the command line nothing is changed.
QUICK = {"ITERATIONS": "1", "TIME_STEP": "0.5", "BETA_GROWTH": "1", "METRIC_STEPS": "0"}


@pytest.fixture
def shell(tmp_path):
    """Runs a line in a folder with scans, where `beltrami` is a command."""
    (tmp_path / "bin").mkdir()
    script = tmp_path / "bin" / "beltrami"
    script.write_text(f'#!/bin/sh\nexec {shlex.join(COMMAND)} "$@"\n')
    script.chmod(0o755)
    work = tmp_path / "work"
    (work / "scans" / "deep er").mkdir(parents=True)
    noisy = SAMPLES / "nonmanifold-noisy.ply"
    for place in ("scan.ply", "face.ply", "scans/a.ply", "scans/deep er/b c.ply"):
        shutil.copy(noisy, work / place)
    (work / "scan.ply.gz").write_bytes(gzip.compress(noisy.read_bytes()))
    write_model(work, "obj", "skin.png", "photoscan.mtl")
    (work / "model.obj").rename(work / "photoscan.obj")
    shutil.copy(SAMPLES / "mirrored-noisy.png", work / "skin.png")
    variables = {f"BELTRAMI_SMOOTH_{name}": value for name, value in QUICK.items()}
    environment = {**os.environ, **variables, "PATH": f"{script.parent}{os.pathsep}{os.environ['PATH']}"}

    def run(line):
        return subprocess.run(
            ["bash", "-o", "pipefail", "-c", line],
            cwd=work, env=environment, capture_output=True, timeout=120, check=False,
        )  # fmt: skip

    run.folder = work
    return run


# 4 s: eight commands, each a process of its own.
@pytest.mark.slow
def test_every_line_for_the_shell_works_as_pasted(shell):
    for line in SHELL.splitlines():
        done = shell(line)
        assert done.returncode == 0, f"{line}\n{done.stderr.decode()}"
    results = ["clean/a.ply", "clean/deep er/b c.ply", "glb/a.glb", "glb/deep er/b c.glb"]
    results += ["scans/a.ply.glb", "scans/deep er/b c.ply.glb", "clean.ply.gz"]
    assert [name for name in results if not (shell.folder / name).is_file()] == []
    made = gzip.decompress((shell.folder / "clean.ply.gz").read_bytes())
    assert made == (shell.folder / "clean" / "a.ply").read_bytes()  # of the same scan


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_the_makefile_makes_what_is_out_of_date_and_nothing_else(shell):
    (shell.folder / "Makefile").write_text(MAKEFILE)
    targets = "all photoscan.clean.obj"
    done = shell(f"make -j4 {targets}")
    assert done.returncode == 0, done.stderr.decode()
    assert (shell.folder / "skin.png").read_bytes() == (SAMPLES / "mirrored-noisy.png").read_bytes()
    assert {path.name for path in shell.folder.glob("*.clean.*")} >= {
        "scan.clean.ply", "face.clean.ply", "photoscan.clean.obj"
    }  # fmt: skip
    assert b"smooth --beta 8 --overwrite face.ply face.clean.ply" in done.stdout

    def out_of_date():
        said = shell(f"make -n {targets}").stdout.decode()
        return set(re.findall(r"--overwrite (\S+)", said))

    assert out_of_date() == set()
    os.utime(shell.folder / "scan.ply")
    assert out_of_date() == {"scan.ply"}
    os.utime(shell.folder / "skin.png")
    assert out_of_date() == {"scan.ply", "photoscan.obj"}
    (shell.folder / "beltrami.toml").touch()
    assert out_of_date() == {"scan.ply", "face.ply", "photoscan.obj"}
