"""Give a document new colours: open, select, take samples, paint, give back, convert, write.

A painter gives samples new colours: by the kernel, by adding noise, and the like. Nobody here asks which samples they
are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from beltrami_cli.jobs.documents import (
    is_moved,
    make_files,
    moved_vertices,
    open_input,
    plan_sidecars,
    with_painted,
)
from beltrami_cli.jobs.job import Stopwatch
from beltrami_cli.samples.memory_check import checked_memory
from beltrami_cli.samples.selection import NOTHING, OutputFormat, choose_format, samples_of, select

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.formats.document import Document, Naming, Written
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.samples.samples import Repainted, Samples
    from beltrami_cli.samples.selection import Selection
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import ImageFile, Slot


class Painter(Protocol):
    """What gives samples new colours."""

    changes: bool  # whether it changes any colour; if not, the output is the input
    colours_only: bool  # whether channels of images that are no colours stay, unless they are named
    works_on_disk: bool
    works_in_groups: bool  # see `DiskUse`

    def check(self, document: Document, selection: Selection, target: OutputFormat) -> None:
        """Raise what cannot be painted, before anything is computed."""

    def paint(self, samples: Samples, job: Job) -> Repainted:
        """Give samples new colours, and return what these make of the document."""


@dataclass(frozen=True)
class Recoloured:
    """A document, the format and the files that were written, and what the user should know."""

    document: Document
    format: str
    written: list[str]
    warnings: list[str]
    stages: dict[str, dict[str, float]]


def recolour(source: str, target: str, settings: SmoothSettings, painter: Painter, job: Job) -> Recoloured:
    """Paint what the settings select of a file, and write it with nothing else changed."""
    watch, output = Stopwatch(), job.output(target)
    access = job.access_besides(output, settings.files_besides(source))
    with watch.stage("read"):
        document = open_input(source, settings, access)
        kind = choose_format(document, target, job.format)
        selection = select(document, settings)
        if not painter.changes and (kind.is_own or kind.suffix is None):
            selection = NOTHING
        painter.check(document, selection, kind)
        sidecars = plan_sidecars(document, selection, settings, kind, (source, target), output, access)
    place = None if output is None else target
    with checked_memory(document, selection.slots, settings.textures, access, place, painter):
        with watch.stage("smooth"):
            painted = _paint(document, selection, settings, painter, replace(job, access=access), kind.suffix)
        with watch.stage("write"):
            in_place = not is_moved(source, target)
            written = _files(document, painted, kind, sidecars.naming, in_place=in_place)
            written = sidecars.complete(written, access)
            if output is not None:
                output.write(written)
    names = [] if output is None else [target, *written.sidecars]
    notices = [*document.notices, *selection.notices, *(n for each in painted for n in each.notices)]
    return Recoloured(document, kind.name, names, [*notices, *written.notices], watch.stages)


def recolour_in_memory(document: Document, settings: SmoothSettings, painter: Painter, job: Job) -> Document:
    """Paint what the settings select, and return it as the document that would be written; the other is kept."""
    selection = select(document, settings) if painter.changes else NOTHING
    painter.check(document, selection, OutputFormat(document.format, is_own=True))
    with checked_memory(document, selection.slots, settings.textures, job.access, None, painter):
        return with_painted(document, _paint(document, selection, settings, painter, job, None))


def _paint(
    document: Document, selection: Selection, settings: SmoothSettings, painter: Painter, job: Job,
    suffix: str | None,
) -> list[Repainted]:  # fmt: skip
    painted = []
    options = {"colours_only": painter.colours_only, "in_groups": painter.works_in_groups}
    for samples in samples_of(document, selection, settings, job.access, suffix, **options):
        samples.require_writable()
        painted.append(painter.paint(samples, job))
        del samples
    return painted


def _files(
    document: Document, painted: Sequence[Repainted], kind: OutputFormat, naming: Naming, *, in_place: bool
) -> Written:
    colours = places = None
    images: dict[tuple[Slot, str], ImageFile] = {}
    for each in painted:
        images |= each.images
        if each.colours is not None:
            colours = each.colours
        if each.positions is not None:
            places = moved_vertices(document, each.positions)
    if in_place:
        images = {key: image for key, image in images.items() if _is_new(document, *key, image)}
    return make_files(document, colours, images, kind, naming, places)


def _is_new(document: Document, slot: Slot, key: str, image: ImageFile) -> bool:
    """Whether an image changed: beside the source, the output names the others as the source does."""
    if slot not in document.slots():
        return True
    return all(image.data != each.data for each in document.textured(slot).textures if each.key == key)
