"""The picture of INPUT and OUTPUT that a smoothing draws by --preview."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access, read_regular
from beltrami_cli.formats.image.containers.png import packed_chunk
from beltrami_cli.formats.image.file_formats import is_image
from beltrami_cli.jobs.writing.file_set import FileSet
from beltrami_cli.jobs.writing.output import Output, Overwrite
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.drawing.image_view import ImageView
from beltrami_cli.view.drawing.panels import draw_views
from beltrami_cli.view.drawing.surface_view import require_embree
from beltrami_cli.view.drawing.views import open_views, require_memory_to_draw
from beltrami_cli.view.render import encoded, picture_suffix
from beltrami_cli.view.settings import DEFAULT_RENDER, Crop, RenderSettings, parts_shown

_MARK = packed_chunk(b"tEXt", b"Software\0beltrami smooth --preview")  # of PNG files that are previews
_MARK_OFFSET = 33  # where it is: behind the signature and IHDR
_HEAD = 1 << 16  # bytes that distinguish images from other files


class Preview:
    """Draws INPUT and OUTPUT of a smoothing, with the richest detail; it fails before anything is computed."""

    def __init__(
        self, path: str, source: str, target: str, settings: SmoothSettings, access: Access, *,
        overwrite: Overwrite, files: FileSet,
    ) -> None:  # fmt: skip
        if "-" in (source, target):
            raise UsageError("--preview draws INPUT and OUTPUT, which must be files and not pipes")
        self._output = Output(path, overwrite=overwrite, what="preview", is_own=is_preview, files=files)
        self._suffix = picture_suffix(path, DEFAULT_RENDER)
        self._source, self._target = source, target
        self._reading, self._access = settings, access
        self._rendering = RenderSettings(crops=(Crop(),), **parts_shown(settings))
        head = b""
        with contextlib.suppress(OSError):  # which is reported when it is smoothed
            head = read_regular(Path(source), access, _HEAD)
        if not is_image(head, source):
            require_embree()

    def check(self, document: Document) -> None:
        both = document, document
        require_memory_to_draw(both, self._rendering, self._access, ", or leave out --preview")

    def draw(self) -> None:
        """Draw and write the picture, after OUTPUT was written aside."""
        before = open_views([self._source], self._rendering, self._access, self._reading)
        after = open_views(
            [self._target], self._rendering, self._output.files.with_staged_files(self._access)
        )
        rendering = self._rendering
        if isinstance(before[0], ImageView):  # which then fills its view
            rendering = replace(rendering, size=before[0].size_within(rendering.size))
        picture = draw_views([*before, *after], ["before", "after"], rendering)
        drawn = encoded(picture, self._output.target, self._suffix)
        if self._suffix == ".png":
            (data,) = map(bytes, drawn.main)
            drawn = Written(main=[data[:_MARK_OFFSET], _MARK, data[_MARK_OFFSET:]])
        self._output.write(drawn)


def is_preview(head: bytes) -> bool:
    """Whether a file bears the mark of previews."""
    return head.startswith(_MARK, _MARK_OFFSET)
