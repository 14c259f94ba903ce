"""Temporary files of a run that was killed are removed by the next one on the same output; those of others stay."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from beltrami_cli.formats.document import Written
from beltrami_cli.jobs import replacing
from beltrami_cli.jobs.output import Output
from beltrami_cli.jobs.replacing import remove_leftovers, temporary_beside

FILES = Written([b"new"], {"a.mtl": b"new", "maps/a.png": b"new"})
# Writes files aside, says so, and waits.
STAGING = """
import sys
from beltrami_cli.formats.document import Written
from beltrami_cli.jobs.output import FileSet, Output
with FileSet() as files:
    Output(sys.argv[1], overwrite=True, files=files).write(
        Written([b"new"], {"a.mtl": b"new", "maps/a.png": b"new"}))
    print("ready", flush=True)
    sys.stdin.read()
"""


def leftovers(folder):
    return sorted(folder.rglob(".*.tmp"))


def test_the_next_run_removes_what_a_killed_one_left_and_not_what_a_live_one_uses(tmp_path):
    target = tmp_path / "out.obj"
    with subprocess.Popen(
        [sys.executable, "-P", "-c", STAGING, str(target)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        assert len(leftovers(tmp_path)) == 3
        output = Output(str(target), overwrite=True)
        output.replaceable = frozenset(FILES.sidecars)
        output.write(FILES)
        assert len(leftovers(tmp_path)) == 3
        process.send_signal(signal.SIGKILL)
    Output(str(tmp_path / "other.obj"), overwrite=True).check_sidecars(["other.mtl"])
    assert len(leftovers(tmp_path)) == 3
    Output(str(target), overwrite=True).check_sidecars(FILES.sidecars)
    assert leftovers(tmp_path) == []


def test_a_process_that_has_the_number_of_one_that_is_gone_is_another(tmp_path, monkeypatch):
    path = tmp_path / "out.ply"
    own = temporary_beside(path)
    monkeypatch.setattr(replacing, "_life", lambda process: "00000000")
    earlier = temporary_beside(path)
    monkeypatch.undo()
    monkeypatch.setattr(replacing, "_machine", lambda: "00000000")
    elsewhere = temporary_beside(path)
    monkeypatch.undo()
    for file in (own, earlier, elsewhere):
        file.touch()
    (tmp_path / ".out.ply.mine.tmp").touch()
    remove_leftovers(path)
    assert set(leftovers(tmp_path)) == {own, elsewhere, tmp_path / ".out.ply.mine.tmp"}


@pytest.mark.parametrize("name", ["x" * 255, "é" * 127, "日" * 85, os.fsdecode(b"\xff" * 250)])
def test_names_as_long_as_a_file_can_have_one(name, tmp_path):
    Output(str(tmp_path / name), overwrite=False).write(Written([b"new"]))
    assert [path.name for path in tmp_path.iterdir()] == [name]
