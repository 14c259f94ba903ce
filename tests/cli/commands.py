"""The command as a user runs it: a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SAMPLES = Path(__file__).parents[2] / "sample_data"
# -P: the installed package is run, not the sources in the working directory.
COMMAND = [sys.executable, "-P", "-m", "beltrami_cli"]


def beltrami(*arguments, stdin=b"", cwd=None):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], input=stdin, capture_output=True, timeout=120, check=False, cwd=cwd
    )
