"""The command: in this process, which saves starting one, or as a user runs it."""

import contextlib
import io
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest

from beltrami_cli.cli.main import group, main
from beltrami_cli.signals import unhandled_signals
from hostile.folders import snapshot

SAMPLES = Path(__file__).parents[2] / "sample_data"
# For signals, limits of memory and what else only a process of its own can show.
# -P: the installed package is run, not the sources in the working directory.
COMMAND = [sys.executable, "-P", "-m", "beltrami_cli"]


def beltrami(*arguments, code=0, stdin=b"", cwd=None, env=None, text=False):
    """Run a command in this process, with some variables more, which must end with a code, if not None."""
    output, errors = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="") for _ in range(2))
    with pytest.MonkeyPatch.context() as patch, kept_signals():
        patch.setenv("OPENBLAS_NUM_THREADS", "1")  # as the command sets it
        for name, value in (env or {}).items():
            patch.setenv(name, str(value))
        if cwd is not None:
            patch.chdir(cwd)
        patch.setattr(sys, "argv", ["beltrami", *map(str, arguments)])
        patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        patch.setattr(sys, "stdout", output)
        patch.setattr(sys, "stderr", errors)
        with pytest.raises(SystemExit) as ended:
            main()
    said = []
    for stream in (output, errors):
        stream.flush()
        written = stream.buffer.getvalue()
        said.append(written.decode() if text else written)
    assert code in (None, ended.value.code), said[1]
    assert "Traceback" not in str(said[1]) or "-vv" in arguments
    return subprocess.CompletedProcess(arguments, ended.value.code, *said)


def run_command(*arguments, **options):
    """Run a command in a process of its own; return how it ended and what it said."""
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, check=False, **options)


def command(name):
    """Return a command of the group, as click has it."""
    return group.get_command(click.Context(group), name)


def copy_samples(folder, *patterns):
    """Copy samples whose names match into a folder; return it."""
    folder.mkdir(parents=True, exist_ok=True)
    for pattern in patterns:
        for path in SAMPLES.glob(pattern):
            shutil.copy(path, folder)
    return folder


def colours_in(report):
    """Return what a report of smoothing says of the colours of a file: of its vertices, image or first texture."""
    said = json.loads(report.read_text())
    return said["vertices"] or said["image"] or said["textures"][0]


def refused(folder, *arguments, code, said="", env=None):
    """Run a command in a folder, which must fail with one line and change nothing; return the line."""
    before = snapshot(folder)
    run = beltrami(*arguments, code=code, cwd=folder, env=env, text=True)
    assert said in run.stderr
    assert run.stderr.startswith("Usage: ") or run.stderr.count("\n") == 1, run.stderr
    assert run.stdout == ""
    assert snapshot(folder) == before
    return run.stderr


def interrupted(process, number, patience=2.0):
    """Send a signal to a running command, which must obey it in so many seconds; return what it said."""
    process.send_signal(number)
    sent = time.monotonic()
    said = process.communicate(timeout=30)[1]
    assert process.returncode == 128 + number, said
    assert time.monotonic() - sent < patience
    assert b"Traceback" not in said
    return said


@contextlib.contextmanager
def kept_signals():
    """Give the signals that the command handles back to who handled them before."""
    handlers = {number: signal.getsignal(number) for number in unhandled_signals()}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
