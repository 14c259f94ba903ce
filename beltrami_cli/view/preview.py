"""A picture of what smoothing did: before and after, with the detail in which there is most to see."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import read_regular
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.view.drawing import draw_views
from beltrami_cli.view.file import encoded, picture_suffix
from beltrami_cli.view.settings import Crop, RenderSettings
from beltrami_cli.view.tracing import require_embree
from beltrami_cli.view.views import open_view

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access
    from beltrami_cli.jobs.writing.files import FileSet
    from beltrami_cli.samples.settings.smooth import SmoothSettings

_HEAD = 1 << 16  # bytes that tell images from others
_LABELS = ("before", "after")


class Preview:
    """Draws a file before and after it is smoothed.

    Parameters
    ----------
    path : str
        The picture.
    source, target : str
        What is smoothed, and where it is written.
    settings : SmoothSettings
        What is smoothed, and how level sets are read.
    access : Access
        What may be read.
    overwrite : bool
        Whether the picture may replace a file.
    files : FileSet
        What the picture belongs to, with what is written of the target.

    Raises
    ------
    UsageError
        If there is no file to draw, or the picture's name is of no image.
    OutputError
        If the picture cannot be written, or would replace a file of the run.
    ProcessingError
        If the package that draws surfaces is not installed.
    """

    def __init__(
        self,
        path: str,
        source: str,
        target: str,
        settings: SmoothSettings,
        access: Access,
        *,
        overwrite: bool,
        files: FileSet,
    ) -> None:
        if "-" in (source, target):
            raise UsageError("--preview draws INPUT and OUTPUT, which must be files and not pipes")
        self._output = Output(path, overwrite=overwrite, what="preview", files=files)
        self._path, self._suffix = path, picture_suffix(path)
        self._source, self._target = source, target
        self._reading, self._access = settings, access
        self._looks = _looks(settings)
        if not is_image(_head(source, access), source):
            require_embree()  # before anything is computed

    def draw(self) -> None:
        """Draw and write the picture, after `target` was written aside."""
        before = open_view(self._source, self._looks, self._access, self._reading)
        after = open_view(self._target, self._looks, self._output.files.with_staged(self._access))
        picture = draw_views([before, after], _LABELS, self._looks)
        self._output.write(encoded(picture, self._path, self._suffix))


def _looks(settings: SmoothSettings) -> RenderSettings:
    slots = settings.textures.slots
    vertices = settings.on == "vertices"
    return RenderSettings(on="vertices" if vertices else "auto", slot=slots[0], crops=(Crop(),))


def _head(source: str, access: Access) -> bytes:
    """Return the first bytes of a file, or none where it is told later why it cannot be read."""
    try:
        return read_regular(Path(source), access, _HEAD)
    except OSError:
        return b""
