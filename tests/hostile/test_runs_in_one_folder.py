"""Runs in one folder: one of two writes an output, and the next removes what a killed one left, and nothing else."""

import errno
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
from unittest.mock import Mock

import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.jobs.writing import locks
from beltrami_cli.jobs.writing.file_set import FileSet
from beltrami_cli.jobs.writing.journal import recover
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.jobs.writing.sidecars import SidecarNames
from cli.commands import COMMAND, SAMPLES
from hostile.folders import snapshot
from hostile.textured_models import KINDS, PICTURE, write_model

# Starts writing when the parent says so, as if all before it had been computed already.
WRITER = """
import sys
from beltrami_cli.errors import OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.jobs.writing.sidecars import SidecarNames

if sys.argv[3] == "no links":
    import errno, os

    def link(*_, **__):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    os.link = link
overwrite = sys.argv[3] == "overwrite"
if overwrite:  # so slowly that each would meet the other
    import time
    from beltrami_cli.jobs.writing import journal

    put = journal.put

    def put_slowly(*arguments, **options):
        put(*arguments, **options)
        time.sleep(0.02)

    journal.put = put_slowly
output = Output(sys.argv[1], overwrite=overwrite)
content = sys.argv[2].encode() * 100_000
print("ready", flush=True)
sys.stdin.readline()
try:
    sidecars = {"a.mtl": content, "maps/a.png": content}
    output.write(Written([content], sidecars), SidecarNames(output.folder, lambda: frozenset(sidecars)))
except OutputError as error:
    assert "exists already" in str(error)
    sys.exit(error.exit_code)
"""


def end_together(processes):
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    errors = [process.communicate(timeout=60)[1] for process in processes]
    assert not any("Traceback" in error for error in errors), errors
    return [process.returncode for process in processes]


def files_of_two_writers(folder, how):
    """Let two processes write the same files; return their exit codes, and the letter that each file is of."""
    folder.mkdir()
    processes = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", WRITER, str(folder / "out.obj"), letter, how],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for letter in "AB"
    ]  # fmt: skip
    codes = end_together(processes)
    files = [path for path in folder.rglob("*") if path.is_file()]
    return codes, {path.relative_to(folder).as_posix(): path.read_text()[0] for path in files}


@pytest.mark.slow
@pytest.mark.parametrize("links", ["links", "no links"])
def test_of_two_that_write_at_the_same_time_one_wins(links, tmp_path):
    for attempt in range(4):
        codes, letters = files_of_two_writers(tmp_path / str(attempt), links)
        assert sorted(codes) == [0, 4]
        assert letters == dict.fromkeys(["out.obj", "a.mtl", "maps/a.png"], "AB"[codes.index(0)])


@pytest.mark.slow
def test_of_two_that_replace_files_at_the_same_time_one_whole_set_stays(tmp_path):
    for attempt in range(3):
        codes, letters = files_of_two_writers(tmp_path / str(attempt), "overwrite")
        assert codes == [0, 0]
        assert set(letters) == {"out.obj", "a.mtl", "maps/a.png"}
        assert len(set(letters.values())) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_of_two_that_replace_a_new_output_the_last_one_wins(kind, tmp_path, monkeypatch):
    """The second run starts and ends while the first one computes; both have seen that there is no OUTPUT."""
    source = write_model(tmp_path / "in", kind, "skin.png")
    (source.parent / "skin.png").write_bytes(PICTURE)
    folder, put = tmp_path / "out", FileSet.commit
    folder.mkdir()

    def run(seed):
        noise = NoiseSettings(sigma=0.1, seed=seed)
        noise_file(source, folder / source.name, noise, job=Job(overwrite=True))
        return snapshot(folder)

    def put_second(files):
        monkeypatch.setattr(FileSet, "commit", put)
        run(2)
        put(files)

    first = run(1)
    for path in folder.iterdir():
        path.unlink()
    monkeypatch.setattr(FileSet, "commit", put_second)
    assert run(1) == first
    assert len(first) > 1
    # A file that the OUTPUT of another run does not name is left alone.
    for path in folder.iterdir():
        path.unlink()
    image = next(name for name in first if name.endswith(".png"))
    monkeypatch.setattr(
        FileSet, "commit", lambda files: ((folder / image).write_text("precious"), put(files))
    )
    with pytest.raises(OutputError, match="exists already"):
        run(1)
    assert {name: content for name, (_, content) in snapshot(folder).items()} == {image: b"precious"}


def test_a_run_that_waits_for_another_for_too_long_leaves_all_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "_LOCK_TIMEOUT", 0.1)
    (tmp_path / "out.obj").write_text("old")
    output = Output(str(tmp_path / "out.obj"), overwrite=True)
    descriptor = os.open(tmp_path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with pytest.raises(OutputError, match="another run"):
            output.write(Written([b"new"], {"a.mtl": b"new"}))
    finally:
        os.close(descriptor)
    assert [path.name for path in tmp_path.iterdir()] == ["out.obj"]
    output.write(Written([b"new"]))
    assert (tmp_path / "out.obj").read_text() == "new"


@pytest.mark.slow
def test_of_two_batches_one_says_done(tmp_path):
    shutil.copy(SAMPLES / "nonmanifold-noisy.ply", tmp_path / "a.ply")
    command = [*COMMAND, "batch", "a.ply", "--out-dir", "out", "-n", "1"]
    pair = [subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[1] for process in pair]
    assert sorted(process.returncode for process in pair) == [0, 4], said
    lines = (tmp_path / "out" / "batch.jsonl").read_text().splitlines()
    assert [json.loads(line)["status"] for line in lines] == ["done"]


@pytest.mark.parametrize("links", [True, False])
def test_a_name_that_is_taken_at_the_last_moment_is_left_alone(links, tmp_path, monkeypatch):
    if not links:
        unsupported = OSError(errno.EOPNOTSUPP, "Operation not supported")
        monkeypatch.setattr(os, "link", Mock(side_effect=unsupported))
    output = Output(str(tmp_path / "out.obj"), overwrite=False)
    (tmp_path / "out.obj").write_text("precious")
    with pytest.raises(OutputError, match=r"out\.obj: exists already.*allow overwriting"):
        output.write(Written([b"new"], {"a.mtl": b"new", "maps/a.png": b"new"}))
    assert [path.name for path in tmp_path.iterdir()] == ["out.obj"]
    assert (tmp_path / "out.obj").read_text() == "precious"


@pytest.mark.parametrize("other", ["./a.png", ".//a.png"])
def test_of_two_sidecar_files_at_one_place_neither_is_lost(other, tmp_path):
    output = Output(str(tmp_path / "out.obj"), overwrite=False)
    with pytest.raises(OutputError):
        output.write(Written([b"new"], {"a.png": b"one", other: b"other"}))
    assert list(tmp_path.iterdir()) == []


def test_of_two_outputs_at_one_place_the_second_is_refused(tmp_path):
    with FileSet() as files:
        Output(str(tmp_path / "out.json"), overwrite=True, what="report", files=files)
        with pytest.raises(OutputError):
            Output(str(tmp_path / "out.json"), overwrite=True, what="report", files=files)


def test_an_output_that_was_a_link_at_first_is_written_when_the_link_is_gone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.obj").write_text("old")
    (tmp_path / "out.obj").symlink_to("there.obj")
    output = Output("out.obj", overwrite=True)
    output.reserve_sidecars(["a.mtl"])
    (tmp_path / "out.obj").unlink()
    output.write(Written([b"new"], {"a.mtl": b"new"}))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mtl", "there.obj"]
    assert (tmp_path / "there.obj").read_text() == "new"


FILES = Written([b"new"], {"a.mtl": b"new", "maps/a.png": b"new"})
# Writes files aside, says so, and waits.
STAGING = """
import sys
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.writing.file_set import FileSet
from beltrami_cli.jobs.writing.output import Output
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
        assert process.stdout.readline() == b"ready\n"
        used = leftovers(tmp_path)
        assert len(used) == 4  # a journal, and a file for each of three
        output = Output(str(target), overwrite=True)
        output.write(FILES, SidecarNames(tmp_path, lambda: frozenset(FILES.sidecars)))
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
    stem = "beltrami-0123456789ab"
    for name in (".out.ply.mine.tmp", ".beltrami-mine.tmp", f".{stem}.0.tmp", f"{stem}.tmp"):
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
