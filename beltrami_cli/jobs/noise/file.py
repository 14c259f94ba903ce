"""Add noise to the colours of a file: for tests, and to show what smoothing takes away again."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.conversion import make_files
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.jobs.sidecars import plan_companions
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import Work, choose_format, choose_work
from beltrami_cli.samples.settings import DEFAULTS, SLOTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.settings import NoiseSettings
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import ImageFile, Slot


@dataclass(frozen=True)
class Added:
    """What noise changed.

    Attributes
    ----------
    what : str
        "vertex colours", "image", or which textures.
    samples : int
        How many samples have noise of their own.
    rms : float
        Root mean square of the change, full scale 1, in the working space; less than sigma where it was cut off.
    """

    what: str
    samples: int
    rms: float

    @classmethod
    def of(cls, what: str, change: NDArray[np.float32]) -> Added:
        """Summarise what was added to the samples' colours."""
        return cls(
            what,
            len(change),
            float(np.sqrt(np.mean(np.square(change, dtype=np.float64)))) if change.size else 0.0,
        )


@dataclass(frozen=True)
class NoiseReport:
    """What was done: to which colours, the files that were written, and what the user should know."""

    added: list[Added]
    files: list[str]
    warnings: list[str]


def noise_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    noise: NoiseSettings,
    settings: SmoothSettings = DEFAULTS,
    *,
    format: str | None = None,  # noqa: A002 -- the name of the option
    overwrite: bool = False,
    access: Access = EVERYTHING_INSIDE,
) -> NoiseReport:
    """Add noise to the colours of a mesh file, of points, of a level set, or of an image, and change nothing else.

    Parameters
    ----------
    source, target : path
        As for `smooth_file`.
    noise : NoiseSettings
        What noise.
    settings : SmoothSettings
        Which colours, and the space that they are changed in; the kernel has no meaning.
    format : str, optional
        Format to write where the name of `target` does not tell.
    overwrite : bool
        Whether existing files may be replaced.
    access : Access
        What may be read.

    Returns
    -------
    NoiseReport

    Raises
    ------
    UsageError
        If the format cannot be told, or settings contradict each other or the file.
    InputError
        If the source cannot be read or holds no colours.
    OutputError
        If the target cannot be written; existing files are as they were.
    """
    source, target = os.fspath(source), os.fspath(target)
    output = Output(target, overwrite=overwrite)
    output.files.guard(settings.files_besides(source))
    data = read_source(source, access)
    if is_image(data, source):
        refuse_options_of_level_sets(settings, source)
        written, added = _image(data, source, target, format, settings, noise, access)
    else:
        document = document_from(data, source, settings, access)
        written, added = _model(document, source, output, format, settings, noise, access)
    output.write(written)
    return NoiseReport(added, [target, *written.sidecars], list(written.notices))


def _image(
    data: bytes,
    source: str,
    target: str,
    chosen: str | None,
    settings: SmoothSettings,
    noise: NoiseSettings,
    access: Access,
) -> tuple[Written, list[Added]]:
    from beltrami_cli.jobs.noise.image import noisy_image
    from beltrami_cli.jobs.smooth.image_file import other_format

    name = "<stdin>" if source == "-" else source
    suffix = other_format(data, name, target, chosen)
    if noise.sigma == 0 and suffix is None:
        return Written([data]), []
    written, change = noisy_image(data, name, suffix, settings, noise, access)
    return written, [Added.of("image", change)]


def _model(
    document: Document,
    source: str,
    output: Output,
    chosen: str | None,
    settings: SmoothSettings,
    noise: NoiseSettings,
    access: Access,
) -> tuple[Written, list[Added]]:
    target = output.target
    target_format = choose_format(document, target, chosen)
    work = choose_work(document, settings)
    if noise.sigma == 0:
        work = Work(vertices=False, slots=())  # the output is the input
    require_room_for_textures(document, work.slots, settings.textures, access)
    companions = plan_companions(document, work, settings, target_format, source, target, output, access)
    colours, images, added, notices = _changed(document, work, settings, noise)
    written = make_files(
        document, colours, images, target_format, Path(target).stem, moved=companions.keep_names
    )
    written = companions.complete(written, access)
    told = (*document.notices, *work.notices, *notices, *written.notices)
    return Written(written.main, written.sidecars, told), added


def _changed(
    document: Document, work: Work, settings: SmoothSettings, noise: NoiseSettings
) -> tuple[NDArray[np.float32] | None, dict[tuple[Slot, str], ImageFile], list[Added], list[str]]:
    colours = None
    added: list[Added] = []
    notices: list[str] = []
    images: dict[tuple[Slot, str], ImageFile] = {}
    if work.vertices:
        from beltrami_cli.jobs.noise.vertices import noisy_vertices

        colours, change = noisy_vertices(document, settings, noise)
        added.append(Added.of("vertex colours", change))
    for slot in work.slots:
        from beltrami_cli.jobs.noise.textures import noisy_slot

        made = noisy_slot(document.textured(slot), slot, settings, noise, 1 + SLOTS.index(slot))
        images.update(made.images)
        added.append(Added.of(f"{slot} textures", made.change))
        notices += made.notices
    return colours, images, added, notices
