"""Smoothing a file."""

from __future__ import annotations

import os
from typing import Any

from beltrami_cli.fields import override
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.recolour import recolour
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.jobs.smooth_report import SmoothReport, smooth_report
from beltrami_cli.jobs.smoothing import Smoothing
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings, describe_settings


def smooth_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    *,
    unwrap: BakeSettings | None = None,
    **overrides: Any,
) -> SmoothReport:
    """Smooth the colours of a file, at its vertices, in its textures or of its pixels, and change nothing else.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB, points (.xyz, .asc, .txt, .csv, .pts, .npz) or an image; "-" for standard input or
        output. If the extension of `target` is that of another format, the file is converted. `source` may also be a
        mesh format that is read only (OFF, STL, 3MF, COLLADA), or a level set on a grid (.npz, .nrrd), which is
        written as a mesh.
    settings : SmoothSettings
        The kernel's parameters, the working space, and the choice of colours. By default the kernel's parameters are
        chosen from the data, by the estimated error of the result.
    job : Job
        What may be read, a callback for progress, and whether files are written and replaced.
    unwrap : BakeSettings, optional
        Put the colours into a new texture atlas, smooth these, and write a new file that contains nothing else.
    **overrides
        Single parameters by name, such as ``iterations=3, slots=("normal",)``, which replace those in `settings`.

    Returns
    -------
    SmoothReport
        The parameters used, counts, noise, changes, times, and the files that were written.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, if parameters contradict each other or the file, or if the format
        of the target is unknown.
    InputError
        If the source cannot be read, is damaged, or has no colours.
    OutputError
        If the target cannot be written, or exists and `job.overwrite` is not set. Existing files stay as they were.
    """
    source, target = os.fspath(source), os.fspath(target)
    settings = override(settings, **overrides)
    if unwrap is not None:
        from beltrami_cli.jobs.unwrapped import smooth_unwrapped

        return smooth_unwrapped(source, target, settings, unwrap, job)
    parameters = describe_settings(settings)
    return smooth_report(*recolour(source, target, settings, Smoothing.of(settings), job, parameters))
