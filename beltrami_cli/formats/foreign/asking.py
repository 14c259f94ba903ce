"""Files that are read by other libraries, in a process of their own."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.foreign.painting import PaintedPolygons
from beltrami_cli.formats.foreign.worker import MISSING

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access

_MODULE = "beltrami_cli.formats.foreign.worker"
_PATIENCE, _PER_MEGABYTE = 60, 10  # seconds
_EXTRA = "install it with: pip install 'beltrami-cli[foreign]'"
_EXPORT = "export it as PLY or glTF"


def ask_worker(kind: str, data: bytes, name: str, access: Access) -> PaintedPolygons:
    """Let a library read a file.

    Parameters
    ----------
    kind : str
        The format: "dae", or an extension that trimesh knows.
    data : bytes
        The file.
    name : str
        Its name for messages.
    access : Access
        How much memory there is.

    Raises
    ------
    InputError
        If the library is missing, does not understand the file, or takes too long or too much memory.
    """
    seconds = _PATIENCE + _PER_MEGABYTE * (len(data) >> 20)
    with (
        tempfile.TemporaryFile() as job,
        tempfile.TemporaryFile() as answer,
        tempfile.TemporaryFile() as said,
    ):
        job.write(data)
        job.seek(0)
        arguments = [kind, str(seconds), str(access.memory or 0)]
        # Without -P a file in the folder where the user happens to be could stand in for a module. In a session of
        # its own the process does not see Ctrl-C, which is for this one.
        worker = subprocess.Popen(
            [sys.executable, "-P", "-m", _MODULE, *arguments],
            stdin=job,
            stdout=answer,
            stderr=said,
            start_new_session=True,
        )
        try:
            worker.wait(seconds)
        except subprocess.TimeoutExpired:
            raise InputError(name, f"it could not be read within {seconds} s", _EXPORT) from None
        finally:
            worker.kill()
            worker.wait()
        said.seek(0)
        answer.seek(0)
        if worker.returncode:
            lines = said.read().decode(errors="replace").strip().splitlines()
            cause = lines[-1][:200] if lines else f"its reader ended with code {worker.returncode}"
            raise InputError(name, cause, _EXTRA if worker.returncode == MISSING else _EXPORT)
        return _unpacked(answer)


def _unpacked(answer: Any) -> PaintedPolygons:
    with np.load(answer, allow_pickle=False) as made:
        return PaintedPolygons(
            made["positions"],
            made["corners"],
            made["sizes"],
            made["colours"],
            str(made["stored"]),
            tuple(made["left_out"].tolist()),
        )
