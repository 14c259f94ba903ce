"""Whichever system call fails, also as a disk is full: all files of a run are new, or old, as the exit code says."""

import errno
import itertools
import logging
import os
import resource
import subprocess

import numpy as np
import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.writing.journal import recover
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.jobs.writing.sidecars import SidecarNames
from cli.commands import COMMAND, SAMPLES, refused, run_command
from formats.image_files import encode
from hostile.folders import snapshot
from hostile.users import acting_as, let_others_pass
from small_models import COLOURED, ply

CALLS = ("link", "replace", "unlink", "fsync", "open", "write", "mkdir", "chmod")
OLD = {"a.png": b"old a", "out.obj": b"old model"}
SIDECARS = {"a.png": b"new a", "maps/b.png": b"new b", "maps/c.png": b"new c", "out.mtl": b"new library"}
MAX_CALLS = 100


def write_set(folder, *, overwrite):
    output = Output(str(folder / "out.obj"), overwrite=overwrite)
    output.write(Written([b"new ", b"model"], SIDECARS), SidecarNames(folder, lambda: frozenset(SIDECARS)))


def fresh(folder, *, has_old):
    folder.mkdir()
    for name, content in OLD.items() if has_old else ():
        (folder / name).write_bytes(content)
    return snapshot(folder)


def temporary_files(folder):
    return [path for path in snapshot(folder) if path.endswith(".tmp")]


class Fault:
    """Lets the n-th call of a function fail, and by wish all after it."""

    def __init__(self, patch, name, code, at, *, for_good):
        self.calls, self.at, self.for_good, self.code = 0, at, for_good, code
        self.function = getattr(os, name)
        patch.setattr(os, name, self)

    def __call__(self, *arguments, **options):
        self.calls += 1
        if self.calls == self.at or (self.for_good and self.calls > self.at):
            named = [each for each in arguments if isinstance(each, str | os.PathLike)]
            raise OSError(self.code, os.strerror(self.code), *map(str, named[:1]))
        return self.function(*arguments, **options)


def attempts(folder, monkeypatch, call, code, *, has_old, for_good):
    """Write a set once for every call of a function, which fails; yield folder, expected content, and the new set."""
    before = fresh(folder / "whole", has_old=has_old)
    write_set(folder / "whole", overwrite=has_old)
    finished = snapshot(folder / "whole")
    for at in range(1, MAX_CALLS):
        fresh(folder / str(at), has_old=has_old)
        with monkeypatch.context() as patch:
            fault = Fault(patch, call, code, at, for_good=for_good)
            try:
                write_set(folder / str(at), overwrite=has_old)
                expected = finished
            except OutputError:
                expected = before
        yield folder / str(at), expected, finished
        if fault.calls < at:
            return
    raise AssertionError("there are more calls than expected")


CODES = (errno.EACCES, errno.EIO, errno.ENOSPC)


@pytest.mark.parametrize(
    ("call", "has_old", "code"),
    [(call, old, CODES[(n + old) % 3]) for n, call in enumerate(CALLS) for old in (False, True)],
)
def test_a_system_call_that_fails_once(call, has_old, code, tmp_path, monkeypatch, caplog):
    runs = attempts(tmp_path, monkeypatch, call, code, has_old=has_old, for_good=False)
    for folder, expected, finished in runs:
        after, stay = snapshot(folder), temporary_files(folder)
        assert {path: content for path, content in after.items() if path not in stay} == expected, folder
        assert call == "unlink" or not stay
        if expected == finished:
            warned = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
            assert len(warned) == bool(stay)
            assert not stay or any(path in warned[0] for path in stay)
        write_set(folder, overwrite=True)
        assert {path: content for path, (_, content) in snapshot(folder).items()} == {
            path: content for path, (_, content) in finished.items()
        }
        caplog.clear()


@pytest.mark.parametrize("has_old", [False, True])
@pytest.mark.parametrize("call", CALLS)
def test_a_system_call_that_fails_from_some_moment_on(call, has_old, tmp_path, monkeypatch):
    runs = attempts(tmp_path, monkeypatch, call, errno.EIO, has_old=has_old, for_good=True)
    for folder, expected, _ in runs:
        # Changes that could not be undone are undone by the next run, as soon as that is possible again.
        recover(folder)
        folders = {"maps"} - set(expected)  # which may stay, without files
        after = snapshot(folder)
        assert {path: content for path, content in after.items() if path not in folders} == expected, folder


@pytest.mark.parametrize("lost", ["the end", "the middle", "everything"])
def test_a_disk_that_loses_what_it_took(lost, tmp_path, monkeypatch):
    before = fresh(tmp_path / "set", has_old=True)

    def lose(descriptor):
        size = os.fstat(descriptor).st_size
        if lost == "the middle" and size:
            os.pwrite(descriptor, b"\0", size // 2)
        elif lost != "the middle":
            os.ftruncate(descriptor, max(0, size - 1) if lost == "the end" else 0)

    monkeypatch.setattr(os, "fsync", lose)
    with pytest.raises(OutputError, match="bytes read back differ"):
        write_set(tmp_path / "set", overwrite=True)
    assert snapshot(tmp_path / "set") == before


def test_only_a_set_of_this_user_in_this_folder_is_undone(tmp_path):
    """A journal that is made up, or copied from elsewhere, touches nothing outside its folder."""
    outside, folder = tmp_path / "precious.txt", tmp_path / "folder"
    outside.write_text("precious")
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    status = outside.stat()
    put = [status.st_size, status.st_mtime_ns]
    stem = ".beltrami-0123456789ab"
    names = (f"{tmp_path}/{stem}.0.tmp", f"../{stem}.0.tmp", f"link/{stem}.0.tmp", f"{stem}.0.tmp")
    targets = ("precious.txt", "../precious.txt", str(outside), "..", ".", "")
    lines = [f'["{name}", "{target}", false, {put}]' for name, target in itertools.product(names, targets)]
    lines += ["[" * 1000, "{}", "[1, 2, 3, 4]", '["a", "b"]', "null", '"x"', '["\\u0000", "a", true, null]']
    (folder / f"{stem}.tmp").write_text("\n".join(lines) + "\n")
    recover(folder)
    assert outside.read_text() == "precious"
    assert sorted(path.name for path in folder.iterdir()) == ["link"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act for two users")
@pytest.mark.parametrize("name", ["out.obj", "a.png"])
def test_a_file_of_another_user_in_a_sticky_folder(name, tmp_path):
    let_others_pass(tmp_path)
    folder = tmp_path / "shared"
    fresh(folder, has_old=True)
    folder.chmod(0o1777)
    user = 12345
    for other in OLD.keys() - {name}:
        os.chown(folder / other, user, user)
    before = snapshot(folder)
    said = r"cannot be written \(Operation not permitted\)"
    with acting_as(user, [user]), pytest.raises(OutputError, match=said):
        write_set(folder, overwrite=True)
    assert snapshot(folder) == before


def run_with_small_files(most, folder, *arguments):
    """Run a command in a folder where files have so many bytes at most; it must end in one line."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    run = run_command(*arguments, cwd=folder, text=True, preexec_fn=limit)
    assert run.stderr.count("\n") == 1, run.stderr
    assert "cannot be written" in run.stderr
    return run.returncode


@pytest.mark.slow
@pytest.mark.parametrize("most", [0, 50_000])
def test_a_limit_on_the_size_of_files(most, tmp_path):
    (tmp_path / "out.ply").write_text("precious")
    before = snapshot(tmp_path)
    smooth = ("smooth", SAMPLES / "terrain-noisy.ply", "out.ply", "--overwrite", "--fast")
    assert run_with_small_files(most, tmp_path, *smooth) == 4
    assert snapshot(tmp_path) == before


@pytest.mark.slow
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
    assert run_with_small_files(most, tmp_path, *arguments) == 4
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_must_not_be_written_to(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="cannot be written to"):
        Output(str(tmp_path / "out.obj"), overwrite=False)


@pytest.mark.parametrize(
    "words",
    [
        "smooth -n 1 -t 1 --beta 9 --dry-run --max-memory 2M photo.png out.png",
        "smooth -n 1 -t 1 --beta 9 model.ply out.usdc",
    ],
)
def test_without_a_folder_for_temporary_files(words, tmp_path, monkeypatch):
    rows = [[0, 0, 0, 9, 9, 9], [1, 0, 0, 9, 8, 7], [0, 1, 0, 1, 2, 3]]
    (tmp_path / "model.ply").write_bytes(ply(COLOURED, rows, [[0, 1, 2]]))
    photo = np.random.default_rng(1).integers(0, 256, (300, 300, 3), np.uint8)
    (tmp_path / "photo.png").write_bytes(encode(photo, "png"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    # This process may already have the memory of many tests.
    monkeypatch.setattr("resource.setrlimit", lambda *_: None)
    said = "temporary files: cannot be written (No such file or directory); "
    refused(tmp_path, *words.split(), code=4, said=said)
