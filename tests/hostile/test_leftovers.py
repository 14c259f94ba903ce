"""Temporary files of a run that was killed are removed by the next one in the folder; other files stay."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from beltrami_cli.formats.document import Written
from beltrami_cli.jobs.output import Output
from beltrami_cli.jobs.replacing import recover

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
        used = leftovers(tmp_path)
        assert len(used) == 4  # a journal, and a file for each of three
        output = Output(str(target), overwrite=True)
        output.replaceable = frozenset(FILES.sidecars)
        output.write(FILES)
        assert leftovers(tmp_path) == used
        process.send_signal(signal.SIGKILL)
    Output(str(tmp_path / "other.obj"), overwrite=True)
    assert leftovers(tmp_path) == []


@pytest.mark.skipif(not hasattr(os, "chown") or os.geteuid() != 0, reason="only root can act for two users")
def test_a_journal_of_another_user_is_left_alone(tmp_path):
    journal = tmp_path / ".beltrami-0123456789ab.tmp"
    journal.touch()
    os.chown(journal, 12345, 12345)
    recover(tmp_path)
    assert leftovers(tmp_path) == [journal]
    os.chown(journal, 0, 0)
    recover(tmp_path)
    assert leftovers(tmp_path) == []


def test_files_that_only_look_like_temporary_ones_stay(tmp_path):
    names = {
        ".out.ply.mine.tmp",
        ".beltrami-mine.tmp",
        ".beltrami-0123456789ab.0.tmp",
        "beltrami-0123456789ab.tmp",
    }
    for name in names:
        (tmp_path / name).touch()
    (tmp_path / ".beltrami-00000000000a.tmp").mkdir()
    (tmp_path / ".beltrami-00000000000b.tmp").symlink_to(".out.ply.mine.tmp")
    before = sorted(tmp_path.iterdir())
    recover(tmp_path)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["x" * 255, "é" * 127, "日" * 85, os.fsdecode(b"\xff" * 250)])
def test_names_as_long_as_a_file_can_have_one(name, tmp_path):
    Output(str(tmp_path / name), overwrite=False).write(Written([b"new"]))
    assert [path.name for path in tmp_path.iterdir()] == [name]
