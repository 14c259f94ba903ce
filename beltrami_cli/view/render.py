"""Draw files side by side in one picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from os.path import commonprefix
from pathlib import Path, PurePath, PurePosixPath

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import require_effect
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.file_formats import FORMATS, format_of_suffix
from beltrami_cli.formats.image.writing import check_writable, write_image
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.view.drawing.image_view import ImageView
from beltrami_cli.view.drawing.panels import draw_views
from beltrami_cli.view.drawing.views import open_views
from beltrami_cli.view.settings import DEFAULT_RENDER, MAX_PIXELS, RenderSettings


def render_file(
    sources: Sequence[str | os.PathLike[str]],
    target: str | os.PathLike[str],
    settings: RenderSettings = DEFAULT_RENDER,
    job: Job = PLAIN_JOB,
) -> tuple[int, int]:
    """Draw models, points and images side by side, write the picture, and return its width and height."""
    names, path = [os.fspath(source) for source in sources], os.fspath(target)
    suffix = picture_suffix(path, settings)
    labels = [*(settings.labels or [])]
    if settings.labels is None and len(names) > 1:
        labels = distinct_labels(names)
    if labels and len(labels) != len(names):
        raise UsageError(f"there are {len(labels)} labels for {len(names)} files; give one --label for each")
    labels = labels or [""] * len(names)
    pixels = len(names) * settings.size[0] * settings.size[1]
    if pixels > MAX_PIXELS:
        cause = f"all views have {pixels} pixels together, but at most {MAX_PIXELS} are drawn"
        raise UsageError(f"{cause}; lower --size")
    output, progress = Output(path, overwrite=job.overwrite, what="picture", reads=names), job.progress
    access = output.files.watching(job.access)
    views = open_views(names, settings, access, progress=progress)
    if all(isinstance(view, ImageView) for view in views):
        require_effect(access.typed, ["images"], names[0])
    picture = draw_views(views, labels, settings, progress)
    output.write(encoded(picture, path, suffix))
    return picture.shape[1], picture.shape[0]


def distinct_labels(paths: Sequence[str]) -> list[str]:
    """Return the names of files; of files with equal names, also what differs in their folders."""
    parts = [PurePath(path).parts for path in paths]
    labels = []
    for path_parts in parts:
        folders_of = [other[:-1] for other in parts if other[-1:] == path_parts[-1:]]
        first = len(commonprefix(folders_of))  # noqa: RUF071 - of tuples
        last = len(commonprefix([folders[first:][::-1] for folders in folders_of]))  # noqa: RUF071
        differing = path_parts[first : len(path_parts) - 1 - last]
        between = ("...",) if last and differing else ()
        labels.append(str(PurePosixPath(*differing, *between, *path_parts[-1:])))
    return labels


def picture_suffix(target: str, settings: RenderSettings, alternatives: str = "") -> str:
    """Return the extension, with the dot, of an image that can be written; `alternatives`: what else could be made."""
    suffix = ".png" if target == "-" else Path(target).suffix.lower()
    if format_of_suffix(suffix) is None:
        raise UsageError(f"its extension is of no image format; call it .png{alternatives}", target)
    known = check_writable(new_image(np.zeros((64, 64, 3), np.uint8), target), suffix)  # of any size
    if settings.background == "transparent" and not FORMATS[known].alpha:
        raise UsageError(f"{suffix} files have no transparent background; choose .png, or a colour", target)
    return suffix


def encoded(picture: Uint8s, target: str, suffix: str) -> Written:
    file = write_image(new_image(picture, target), picture, suffix=suffix, small=True)
    return Written(main=[file.data])
