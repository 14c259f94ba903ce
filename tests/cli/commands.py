"""The command: in this process, which saves starting one, or as a user runs it."""

from __future__ import annotations

import contextlib
import io
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from beltrami_cli.cli.main import main

SAMPLES = Path(__file__).parents[2] / "sample_data"
# For signals, limits of memory and what else only a process of its own can show.
# -P: the installed package is run, not the sources in the working directory.
COMMAND = [sys.executable, "-P", "-m", "beltrami_cli"]


def beltrami(*arguments, stdin=b"", cwd=None, env=None, text=False):
    """Run a command in this process, with some variables more; return its exit code and output."""
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
    return subprocess.CompletedProcess(arguments, ended.value.code, *said)


@contextlib.contextmanager
def kept_signals():
    """Give the signals that the command handles back to who handled them before."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if hasattr(signal, "SIGHUP"):
        handlers[signal.SIGHUP] = signal.getsignal(signal.SIGHUP)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
