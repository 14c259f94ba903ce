"""Draw files in one picture: read, draw, write."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image import format_of_suffix, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.view.drawing import draw_views
from beltrami_cli.view.settings import DEFAULT_RENDER, MOST_PIXELS, RenderSettings
from beltrami_cli.view.views import open_view

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray


def render_file(
    sources: Sequence[str | os.PathLike[str]],
    target: str | os.PathLike[str],
    settings: RenderSettings = DEFAULT_RENDER,
    *,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> tuple[int, int]:
    """Draw models, points and images side by side, and write the picture.

    Parameters
    ----------
    sources : sequence of path
        The files, at least one.
    target : path
        An image of any format that can be written; "-" for standard output, as PNG.
    settings : RenderSettings
        The camera, the light, the layout.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : callable, optional
        Called with a label, the views drawn and the views to draw; may raise to stop.
    access : Access
        What may be read.

    Returns
    -------
    (int, int)
        Width and height of the picture.

    Raises
    ------
    UsageError
        If settings contradict the files or each other, or the target's name is of no image.
    InputError
        If a file cannot be read or has no colours.
    OutputError
        If the target cannot be written, or is one of the sources.
    ProcessingError
        If the package that draws surfaces is not installed.
    """
    names, path = [os.fspath(source) for source in sources], os.fspath(target)
    suffix = picture_suffix(path)
    labels = _labels(names, settings)
    _check_size(len(names), settings)
    output = Output(path, overwrite=overwrite, what="picture", reads=names)
    access = output.files.watching(access)
    views = [open_view(name, settings, access) for name in names]
    picture = draw_views(views, labels, settings, progress)
    output.write(encoded(picture, path, suffix))
    return picture.shape[1], picture.shape[0]


def picture_suffix(target: str, others: str = "") -> str:
    """Return the extension that tells the format of a picture, with the dot; `others` is what else could be made.

    Raises
    ------
    UsageError
        If it tells none that can be written.
    """
    suffix = ".png" if target == "-" else Path(target).suffix.lower()
    if format_of_suffix(suffix) is None:
        raise UsageError(f"{target}: its name tells no image format; call it .png{others}")
    return suffix


def encoded(picture: NDArray[np.uint8], target: str, suffix: str) -> Written:
    """Return a picture as the file that it is written as."""
    file = write_image(new_picture(picture, target), picture, suffix=suffix, small=True)
    return Written(main=[file.data])


def _labels(names: Sequence[str], settings: RenderSettings) -> list[str]:
    labels = settings.labels
    if labels is None:
        return [Path(name).name for name in names] if len(names) > 1 else [""]
    if labels and len(labels) != len(names):
        raise UsageError(f"there are {len(labels)} labels for {len(names)} files; give one --label for each")
    return list(labels) or [""] * len(names)


def _check_size(files: int, settings: RenderSettings) -> None:
    pixels = files * max(1, settings.turntable) * settings.size[0] * settings.size[1]
    if pixels > MOST_PIXELS:
        raise UsageError(
            f"all views have {pixels} pixels together, but at most {MOST_PIXELS} are drawn; lower --size"
        )
