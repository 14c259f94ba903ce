"""Draw files in one picture, or in a moving one: any files, or what a smoothing reads and writes.

Turntables are GIF or WebP by Pillow, or MP4 by PyAV.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import Access, read_regular
from beltrami_cli.formats.document import Document, Written
from beltrami_cli.formats.image import format_of_suffix, write_image
from beltrami_cli.formats.image.picture import is_image, new_picture
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.output import FileSet, Output, Overwrite
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.drawing import distinct_labels, draw_turns, draw_views
from beltrami_cli.view.settings import DEFAULT_RENDER, MOST_PIXELS, Crop, RenderSettings
from beltrami_cli.view.tracing import imported, require_embree
from beltrami_cli.view.views import open_views, require_memory_to_draw

Frames = Sequence[Uint8s]  # of one size, (H, W, 3), or (H, W, 4) with opacity

# A preview has no mark, and its bytes shall stay. But all have this head: their size, 8 bits of RGB, and no metadata.
_SIZE = (1288, 1013)
_PNG = struct.pack(">8sI4sIIBBBBB", b"\x89PNG\r\n\x1a\n", 13, b"IHDR", *_SIZE, 8, 2, 0, 0, 0)
_KIND = slice(37, 41)  # of the second block of a PNG file
_HEAD = 1 << 16  # bytes that distinguish images from other files
_WEBP_QUALITY = 90
_MP4_QUALITY = "16"  # constant rate factor of H.264: what cannot be distinguished from the original


def render_file(
    sources: Sequence[str | os.PathLike[str]],
    target: str | os.PathLike[str],
    settings: RenderSettings = DEFAULT_RENDER,
    job: Job = PLAIN_JOB,
) -> tuple[int, int]:
    """Draw models, points and images side by side, write the picture, and return its width and height."""
    names, path = [os.fspath(source) for source in sources], os.fspath(target)
    suffix = _suffix_of(path, settings)
    labels = [*(settings.labels or [])]
    if settings.labels is None and len(names) > 1:
        labels = distinct_labels(names)
    if labels and len(labels) != len(names):
        raise UsageError(f"there are {len(labels)} labels for {len(names)} files; give one --label for each")
    labels = labels or [""] * len(names)
    pixels = len(names) * max(1, settings.turntable) * settings.size[0] * settings.size[1]
    if pixels > MOST_PIXELS:
        cause = f"all views have {pixels} pixels together, but at most {MOST_PIXELS} are drawn"
        raise UsageError(f"{cause}; lower --size")
    output, progress = Output(path, overwrite=job.overwrite, what="picture", reads=names), job.progress
    access = output.files.watching(job.access)
    views = open_views(names, settings, access, progress=progress)
    if settings.turntable > 1 and suffix in ANIMATIONS:
        frames = draw_turns(views, labels, settings, progress)
        output.write(Written(main=[_ENCODERS[suffix](frames, settings.fps)]))
        return frames[0].shape[1], frames[0].shape[0]
    picture = draw_views(views, labels, settings, progress)
    output.write(encoded(picture, path, suffix))
    return picture.shape[1], picture.shape[0]


def _suffix_of(target: str, settings: RenderSettings) -> str:
    """Return the extension of a picture, or of a turntable that moves; errors if it cannot be written."""
    suffix = Path(target).suffix.lower()
    if suffix not in ANIMATIONS:
        return picture_suffix(target)
    if settings.turntable > 1:
        if suffix == ".mp4":
            _av()
        if suffix == ".mp4" and settings.background == "transparent":
            raise UsageError("an .mp4 file has no transparent background; choose .webp or .gif, or a colour")
    elif suffix != ".webp":
        raise UsageError(
            f"{target}: {suffix} is for turntables; add --turntable 24, or call it .png for a still picture"
        )
    return suffix


class Preview:
    """Draws INPUT and OUTPUT of a smoothing, with the richest detail; it fails before anything is computed."""

    def __init__(
        self, path: str, source: str, target: str, settings: SmoothSettings, access: Access, *,
        overwrite: Overwrite, files: FileSet,
    ) -> None:  # fmt: skip
        if "-" in (source, target):
            raise UsageError("--preview draws INPUT and OUTPUT, which must be files and not pipes")
        self._output = Output(path, overwrite=overwrite, what="preview", is_own=is_preview, files=files)
        self._suffix = picture_suffix(path)
        self._source, self._target = source, target
        self._reading, self._access = settings, access
        on: Literal["vertices", "auto"] = "vertices" if settings.on == "vertices" else "auto"
        self._looks = RenderSettings(on=on, slot=settings.textures.slots[0], crops=(Crop(),))
        head = b""
        with contextlib.suppress(OSError):  # which is reported when it is smoothed
            head = read_regular(Path(source), access, _HEAD)
        if not is_image(head, source):
            require_embree()

    def check(self, document: Document) -> None:
        both = document, document
        require_memory_to_draw(both, self._looks, self._access, ", or leave out --preview")

    def draw(self) -> None:
        """Draw and write the picture, after OUTPUT was written aside."""
        before = open_views([self._source], self._looks, self._access, self._reading)
        after = open_views([self._target], self._looks, self._output.files.with_staged(self._access))
        picture = draw_views([*before, *after], ["before", "after"], self._looks)
        self._output.write(encoded(picture, self._output.target, self._suffix))


def is_preview(head: bytes) -> bool:
    """Whether a file begins as previews do."""
    return head.startswith(_PNG) and head[_KIND] == b"IDAT"


def picture_suffix(target: str, others: str = "") -> str:
    """Return the extension, with the dot, of an image that can be written; `others` is what else could be made."""
    suffix = ".png" if target == "-" else Path(target).suffix.lower()
    if format_of_suffix(suffix) is None:
        raise UsageError(f"{target}: its extension is of no image format; call it .png{others}")
    return suffix


def encoded(picture: Uint8s, target: str, suffix: str) -> Written:
    """Return a picture as the file that it is written as."""
    file = write_image(new_picture(picture, target), picture, suffix=suffix, small=True)
    return Written(main=[file.data])


def _by_pillow(frames: Frames, rate: int, kind: str, **options: Any) -> bytes:
    first, *others = [Image.fromarray(frame) for frame in frames]
    data = io.BytesIO()
    duration = round(1000 / rate)
    first.save(data, kind, save_all=True, append_images=others, duration=duration, loop=0, **options)
    return data.getvalue()


def _av() -> Any:
    return imported("av", "PyAV", "animation", "to write turntables as .mp4")


def _mp4(frames: Frames, rate: int) -> bytes:
    av = _av()
    height, width = frames[0].shape[:2]
    data = io.BytesIO()
    with av.open(data, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate), options={"crf": _MP4_QUALITY})
        # Players want half the resolution of colour, and so even sides.
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        for frame in frames:
            even = np.pad(frame[..., :3], [(0, height % 2), (0, width % 2), (0, 0)], mode="edge")
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(even), "rgb24")))
        container.mux(stream.encode())
    return data.getvalue()


_ENCODERS: dict[str, Callable[[Frames, int], bytes]] = {
    ".gif": partial(_by_pillow, kind="GIF", disposal=2),
    ".webp": partial(_by_pillow, kind="WEBP", quality=_WEBP_QUALITY),
    ".mp4": _mp4,
}
ANIMATIONS = tuple(_ENCODERS)
"""Suffixes of turntables that move."""
