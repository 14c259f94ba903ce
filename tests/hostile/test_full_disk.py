"""A disk that fills up, a limit on files, a rename that fails: one line, exit code 4, and everything is as it was."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.jobs.output import Output
from cli.commands import COMMAND, SAMPLES, refused
from formats.image_files import encode
from hostile.folders import snapshot
from hostile.test_interruptions import folder_with_model
from small_models import COLOURED, ply

# In a name space of one's own anybody may mount, where the system lets them have one.
OWN_SPACE = ["unshare", "--user", "--map-root-user", "--mount"]
CAN_MOUNT = (
    shutil.which("unshare") is not None
    and subprocess.run(
        [*OWN_SPACE, "mount", "-t", "tmpfs", "none", "/mnt"], check=False, capture_output=True
    ).returncode
    == 0
)


def run_with_small_files(most, folder, *arguments):
    """Run a command in a folder where files have so many bytes at most; it must end in one line."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    command = [*COMMAND, *map(str, arguments)]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, preexec_fn=limit)
    assert run.stderr.count("\n") == 1, run.stderr
    assert "cannot be written" in run.stderr
    return run.returncode


@pytest.mark.slow
@pytest.mark.parametrize("most", [0, 50_000])
def test_a_limit_on_the_size_of_files(most, tmp_path):
    (tmp_path / "out.ply").write_text("precious")
    before = snapshot(tmp_path)
    smooth = ("smooth", SAMPLES / "terrain-noisy.ply", "out.ply", "--overwrite")
    assert run_with_small_files(most, tmp_path, *smooth) == 4
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("words", [("info", "{}"), ("smooth", "{}", "-", "-n", "0")])
def test_a_reader_that_has_enough_is_no_failure_to_speak_of(words):
    arguments = [*COMMAND, *(word.format(SAMPLES / "terrain-noisy.ply") for word in words)]
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as unread:
        run = subprocess.run(arguments, stdout=unread, stderr=subprocess.PIPE, check=False)
    assert (run.returncode, run.stderr) == (4, b"")


# Mounts a small disk, copies a folder there, fills all but a few pages, and runs the command.
ON_SMALL_DISK = """
import os, pathlib, shutil, subprocess, sys
sys.path.insert(0, sys.argv[1])
from hostile.folders import snapshot
source, disk, free, arguments = sys.argv[2], pathlib.Path(sys.argv[3]), int(sys.argv[4]), sys.argv[5:]
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk], check=True)
shutil.copytree(source, disk / "work")
room = os.statvfs(disk).f_bavail * os.statvfs(disk).f_bsize
(disk / "filler").write_bytes(bytes(room - 4096 * free))
before = snapshot(disk)
code = subprocess.run(arguments, cwd=disk / "work", check=False).returncode
print(code, snapshot(disk) == before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not CAN_MOUNT, reason="no file system can be mounted here")
@pytest.mark.parametrize(
    # Free pages: a probe takes none, OBJ, MTL and PNG take one each, and in its place MTL stays.
    ("free", "target"),
    [(0, "out/result.obj"), (1, "model.obj"), (1, "new/result.obj"), (2, "out/result.obj")],
)
def test_a_disk_that_fills_up(free, target, tmp_path):
    folder, disk = folder_with_model(tmp_path), tmp_path / "disk"
    (folder / "new").mkdir()
    disk.mkdir()
    tests = str(Path(__file__).parents[1])
    script = [sys.executable, "-c", ON_SMALL_DISK, tests, str(folder), str(disk), str(free)]
    run = subprocess.run(
        [*OWN_SPACE, *script, *COMMAND, "smooth", "model.obj", target, "--overwrite"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert run.stdout == "4 True\n", run.stderr
    assert run.stderr.count("\n") == 1
    assert "No space left" in run.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "most"),
    [
        *((("smooth", "{}", "out.glb", "--unwrap", "-n", "0"), most) for most in (0, 20_000, 60_000)),
        *((("bake", "{}", "out.glb", "--to", "texture"), most) for most in (1000, 40_000)),
    ],
)
def test_a_limit_on_temporary_files(words, most, tmp_path):
    """Neither the question to the process that unwraps nor, with higher limits, its answer can be written."""
    arguments = (word.format(SAMPLES / "nonmanifold-noisy.ply") for word in words)
    assert run_with_small_files(most, tmp_path, *arguments) in (1, 4)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_must_not_be_written_to(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="cannot be written to"):
        Output(str(tmp_path / "out.obj"), overwrite=False)


@pytest.mark.parametrize(
    "words",
    [
        "smooth -n 1 -t 1 --beta 9 photo.png out.jp2",
        "smooth -n 1 -t 1 --beta 9 --dry-run --max-memory 2M photo.png out.png",
        "smooth -n 1 -t 1 --beta 9 model.ply out.usdc",
        "bake --to texture model.ply out.glb",
    ],
)
def test_without_a_folder_for_temporary_files(words, tmp_path, monkeypatch):
    (tmp_path / "model.ply").write_bytes(
        ply(COLOURED, [[0, 0, 0, 9, 9, 9], [1, 0, 0, 9, 8, 7], [0, 1, 0, 1, 2, 3]], [[0, 1, 2]])
    )
    (tmp_path / "photo.png").write_bytes(
        encode(np.random.default_rng(1).integers(0, 256, (300, 300, 3), np.uint8), "png")
    )
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    refused(
        tmp_path,
        *words.split(),
        code=1,
        said="temporary files cannot be written (No such file or directory); ",
    )
