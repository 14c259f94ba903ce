"""Files that are read by other libraries, in a process of their own."""

from __future__ import annotations

import subprocess
import tempfile
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.foreign.painting import PaintedPolygons
from beltrami_cli.formats.foreign.worker import MISSING
from beltrami_cli.surface.worker_process import working

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
    with tempfile.TemporaryFile() as job:
        job.write(data)
        job.seek(0)
        with working(_MODULE, job, [kind, str(seconds), str(access.memory or 0)]) as worker:
            try:
                worker.process.wait(seconds)
            except subprocess.TimeoutExpired:
                raise InputError(name, f"it could not be read within {seconds} s", _EXPORT) from None
            if (cause := worker.failure()) is not None:
                missing = worker.process.returncode == MISSING
                raise InputError(name, cause[:200], _EXTRA if missing else _EXPORT)
            return _unpacked(worker.answer)


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
