"""Unwrapping in a process of its own, which can be ended, and how long that takes."""

from __future__ import annotations

import subprocess
import tempfile
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import ProcessingError
from beltrami_cli.surface.worker_process import working

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_WORKER = "beltrami_cli.surface.unwrap_worker"
_POLL = 0.1  # seconds between looks at whether it is done or the user wants to stop
# Measured: 16 thousand triangles take 7 s, 82 thousand 109 s.
_SECONDS, _FACES, _GROWTH = 160.0, 100_000, 1.7
_PATIENCE = 10  # times as long as expected; beyond that it hangs
_LEAST_PATIENCE = 120.0


def expected_seconds(faces: int) -> float:
    """Tell how long unwrapping so many triangles takes."""
    return float(_SECONDS * (faces / _FACES) ** _GROWTH)


def shown(seconds: float) -> str:
    """Return a time for people."""
    return f"{seconds / 60:.0f} minutes" if seconds >= 90 else f"{max(1.0, seconds):.0f} s"


def ask_worker(
    arrays: dict[str, Any], padding: int, progress: Callable[[int, int], None] | None
) -> tuple[NDArray[np.float64], int, int]:
    """Have a mesh unwrapped.

    Parameters
    ----------
    arrays : dict
        Positions, triangles, sides to try and texels wanted, as `unwrap_worker` takes them.
    padding : int
        Texels between charts.
    progress : callable, optional
        Called several times a second with the tenths of a second that went by and those that are expected; may raise.

    Returns
    -------
    corners : ndarray of float64, shape (F, 3, 2)
        Places of corners, in texels.
    side : int
        The side that was chosen, without the margin.
    charts : int
        How many.

    Raises
    ------
    ProcessingError
        If xatlas fails or hangs.
    """
    expected = expected_seconds(len(arrays["faces"]))
    patience = max(_LEAST_PATIENCE, _PATIENCE * expected)
    with tempfile.TemporaryFile() as job:
        np.savez(job, numbers=[padding, int(patience) + 10], **arrays)
        job.seek(0)
        with working(_WORKER, job) as worker:
            _wait(worker.process, patience, expected, progress)
            if (cause := worker.failure()) is not None:
                raise ProcessingError(f"xatlas could not unwrap the mesh ({cause}); repair or simplify it")
            with np.load(worker.answer, allow_pickle=False) as made:
                return made["corners"], int(made["size"]), int(made["charts"])


def _wait(
    worker: subprocess.Popen[bytes],
    patience: float,
    expected: float,
    progress: Callable[[int, int], None] | None,
) -> None:
    start = time.monotonic()
    total = max(1, int(10 * expected))
    while True:
        try:
            worker.wait(_POLL)
        except subprocess.TimeoutExpired:
            gone = time.monotonic() - start
            if gone > patience:
                cause = f"unwrapping did not end within {patience:.0f} s, though {expected:.0f} s are usual"
                raise ProcessingError(f"{cause}; repair or simplify the mesh") from None
            if progress is not None:
                progress(min(int(10 * gone), total), total)
        else:
            if progress is not None:
                progress(total, total)
            return
