"""A disk that fills up, a limit on files, a rename that fails: one line, exit code 4, and everything is as it was."""

from __future__ import annotations

import os
import resource
import subprocess

import numpy as np
import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.jobs.output import Output
from cli.commands import COMMAND, SAMPLES, refused
from formats.image_files import encode
from hostile.folders import snapshot
from small_models import COLOURED, ply


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
