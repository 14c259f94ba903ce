"""Standard streams that are closed or full, and a working folder that is gone: it works, or ends with a sentence."""

import os
import subprocess

import pytest

from cli.commands import COMMAND, SAMPLES

SCAN = SAMPLES / "nonmanifold-noisy.ply"
QUICK = ("--fast", "-n", "1")


def run(redirection, *arguments, **options):
    """Run the command as a shell does with a redirection."""
    return subprocess.run(
        ["sh", "-c", f'exec "$@" {redirection}', "sh", *COMMAND, *arguments],
        capture_output=True, check=False, timeout=60, **options,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("redirection", ["2>&-", "2>/dev/full", "0<&- 1>&- 2>&-", ">/dev/full"])
def test_a_file_is_written_whatever_the_streams_are(redirection, tmp_path):
    done = run(redirection, "smooth", str(SCAN), str(tmp_path / "out.ply"), *QUICK)
    assert done.returncode == 0
    assert (tmp_path / "out.ply").read_bytes().startswith(b"ply")
    assert [path.name for path in tmp_path.iterdir()] == ["out.ply"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "redirection", "why"),
    [
        (("info", str(SCAN), "--fast"), ">&-", b"is closed"),
        (("smooth", str(SCAN), "-", *QUICK), ">/dev/full", b"No space left"),
        (("--help",), ">&-", b"is closed"),
        (("config",), ">/dev/full", b"No space left"),
    ],
)
def test_what_cannot_be_written_to_standard_output_is_said(arguments, redirection, why):
    done = run(redirection, *arguments)
    assert (done.returncode, done.stdout) == (4, b"")
    *_, last = done.stderr.splitlines()
    assert last.startswith(b"beltrami: <stdout>: ")
    assert why in last
    assert b"Traceback" not in done.stderr
    assert b"unexpected" not in done.stderr


@pytest.mark.slow
def test_the_device_of_standard_output_goes_through_a_pipe():
    done = run("", "smooth", str(SCAN), "/dev/stdout", *QUICK)
    assert done.stdout.startswith(b"ply")
    assert done.stdout == run("", "smooth", str(SCAN), "-", *QUICK).stdout


def test_an_input_that_is_closed_is_an_empty_one():
    done = run("<&-", "info", "-")
    assert (done.returncode, done.stderr.count(b"\n")) == (3, 1)
    assert b"<stdin>: the file is empty" in done.stderr


def test_an_input_that_cannot_be_read_is_said(tmp_path):
    done = run(f"0> {tmp_path}/file", "info", "-")
    assert (done.returncode, done.stderr.count(b"\n")) == (3, 1)
    assert b"<stdin>: cannot be read" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("home", [{}, {"HOME": "/nowhere"}])
def test_a_working_folder_that_was_removed(home, tmp_path):
    variables = {name: value for name, value in os.environ.items() if name != "HOME"} | home
    gone = 'mkdir gone && cd gone && rmdir ../gone && exec "$@"'
    ends = (str(SCAN), "out.ply"), (str(SCAN), str(tmp_path / "out.ply"))
    codes = []
    for source, target in ends:
        arguments = ["sh", "-c", gone, "sh", *COMMAND, "smooth", source, target, *QUICK]
        done = subprocess.run(arguments, cwd=tmp_path, env=variables, capture_output=True, check=False)
        codes.append(done.returncode)
        assert b"Traceback" not in done.stderr
        assert b"unexpected" not in done.stderr
    assert codes == [3, 0]
    assert b"working folder" not in done.stderr
    assert (tmp_path / "out.ply").exists()


def test_warnings_of_libraries_are_not_printed():
    program = "import beltrami_cli.__main__, warnings; warnings.warn('of numbers', RuntimeWarning)"
    done = subprocess.run([*COMMAND[:2], "-c", program], capture_output=True, check=True)
    assert done.stderr == b""
