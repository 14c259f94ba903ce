"""Give a document new colours: open, select, take samples, paint, give back, convert, write.

A painter gives samples new colours: by the kernel, by adding noise, and the like. Nobody here asks which samples they
are. OUTPUT has the format that it asks for, and beside it are the files that belong there.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.fields import given_options
from beltrami_cli.formats import registry
from beltrami_cli.formats.access import Access, read_source
from beltrami_cli.formats.document import Document, Naming, Written
from beltrami_cli.formats.image.picture import suffix_for
from beltrami_cli.formats.textured_mesh import as_if_with_suffixes, with_images, with_suffixes
from beltrami_cli.jobs.job import Job, Stopwatch, peak_memory
from beltrami_cli.jobs.output import Output
from beltrami_cli.jobs.repainted_document import with_new_colours
from beltrami_cli.jobs.shared_files import shared_files
from beltrami_cli.samples.memory_check import checked_memory
from beltrami_cli.samples.samples import Repainted, Samples
from beltrami_cli.samples.selection import NOTHING, OutputFormat, Selection, choose_format, samples_of, select
from beltrami_cli.samples.settings import SmoothSettings
from beltrami_cli.samples.texel_colours import choose_textures
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import ImageFile, MovedVertices, Slot


class Painted(Protocol):
    """What a painter made of samples; painters add what they report of it."""

    @property
    def repainted(self) -> Repainted: ...

    @property
    def warnings(self) -> Sequence[str]: ...


AnyPainted = TypeVar("AnyPainted", bound=Painted)


class Painter(ABC, Generic[AnyPainted]):
    """What gives samples new colours. It is immutable; what it did is in what it returns."""

    colours_only: ClassVar[bool] = (
        True  # whether channels of images that are no colours stay, unless they are named
    )
    works_on_disk: ClassVar[bool] = (
        False  # whether textures too large for memory can be painted, together in files
    )

    @property
    def changes(self) -> bool:
        """Whether it changes any colour; if not, the output is the input."""
        return True

    @property
    def works_in_groups(self) -> bool:
        """Whether textures too large for memory can be painted some at a time."""
        return False

    def prepared(self, document: Document, selection: Selection, target: OutputFormat) -> Self:
        """Return the painter for a document; errors if it cannot be painted, before anything is computed."""
        del document, selection, target
        return self

    @abstractmethod
    def paint(self, samples: Samples, job: Job) -> AnyPainted:
        """Give samples new colours."""


@dataclass(frozen=True, kw_only=True)
class FileReport:
    """What is said of every file that was written; `SmoothReport` describes it."""

    input: str
    output: str
    format: str
    parameters: dict[str, object] = field(default_factory=dict)
    stages: dict[str, dict[str, float]] = field(default_factory=dict)
    peak_memory: int | None = field(default_factory=peak_memory)
    written: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def recolour(
    source: str, target: str, settings: SmoothSettings, painter: Painter[AnyPainted], job: Job
) -> tuple[FileReport, list[AnyPainted]]:
    """Paint what the settings select of a file, and write it with nothing else changed."""
    watch, (output, access) = Stopwatch(), job.output(target, settings.files_besides(source))
    with watch.stage("read"):
        document = open_input(source, settings, access)
        kind = choose_format(document, target, job.format)
        selection = select(document, settings)
        if not painter.changes and (kind.is_own or kind.suffix is None):
            selection = NOTHING
        painter = painter.prepared(document, selection, kind)
        if job.check is not None:
            job.check(document)
        others: dict[str, None] = {}
        naming = naming_of(document, source, target, output, access, others)
        if output is not None:
            output.check_sidecars(_names(naming, document, selection, settings, kind))
    beside = []
    if others:
        state = "is of something else, and stays" if len(others) == 1 else "are of something else, and stay"
        beside = [f"{', '.join(others)} beside OUTPUT {state}; what is new has a number in its name."]
    place = None if output is None else target
    use = {"on_disk": painter.works_on_disk, "in_groups": painter.works_in_groups}
    with checked_memory(
        document, selection.slots, settings.textures, access, place, image=selection.image, **use
    ):
        with watch.stage("smooth"):
            painted = _paint(document, selection, settings, painter, replace(job, access=access), kind.suffix)
        with watch.stage("write"):
            new = [each.repainted for each in painted]
            written = _files(document, new, kind, naming, in_place=not is_moved(source, target))
            folder = Path(source).parent
            copied = {new: read_source(str(folder / old), access) for new, old in written.copies.items()}
            written = replace(written, sidecars={**written.sidecars, **copied})
            if output is not None:
                if output.folder is not None and output.overwrite:
                    beside += shared_files(output.folder, output.path, written.sidecars)
                output.write(written)
    names = [] if output is None else [target, *written.sidecars]
    notices = [*document.notices, *selection.notices, *(notice for each in new for notice in each.notices)]
    # Several slots say the same of one surface.
    warnings = list(dict.fromkeys([*notices, *beside, *written.notices]))
    warnings += [warning for each in painted for warning in each.warnings]
    report = FileReport(
        input=source, output=target, format=kind.name, stages=watch.stages, written=names, warnings=warnings
    )
    return report, painted


def recolour_in_memory(
    document: Document, settings: SmoothSettings, painter: Painter[AnyPainted], job: Job
) -> tuple[Document, list[AnyPainted]]:
    """Paint what the settings select, and return it as the document that would be written; the other is kept."""
    selection = select(document, settings) if painter.changes else NOTHING
    painter = painter.prepared(document, selection, OutputFormat(document.format, is_own=True))
    use = {"on_disk": painter.works_on_disk, "in_groups": painter.works_in_groups}
    with checked_memory(
        document, selection.slots, settings.textures, job.access, None, image=selection.image, **use
    ):
        painted = _paint(document, selection, settings, painter, job, None)
    return with_new_colours(document, [each.repainted for each in painted]), painted


def _paint(
    document: Document,
    selection: Selection,
    settings: SmoothSettings,
    painter: Painter[AnyPainted],
    job: Job,
    suffix: str | None,
) -> list[AnyPainted]:
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


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as a document; errors if it is unsupported, or no level set."""
    return document_from(read_source(source, access), source, settings, access)


def document_from(data: bytes, source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a source whose bytes have been read already; see `open_input`."""
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    line = registry.recognised(data, name)
    if line is not None and line.kind == "volume":
        from beltrami_cli.samples.voxels import LevelSetDocument

        return LevelSetDocument(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    if wrong := given_options(settings.level_set):
        raise UsageError(f"{', '.join(wrong)}: for level sets, and {name} is none")
    return registry.open_as(line, data, name, folder, access)


def make_files(
    document: Document, colours: Float32s | None, images: Mapping[tuple[Slot, str], ImageFile], kind: OutputFormat,
    naming: Naming, places: MovedVertices | None = None,
) -> Written:  # fmt: skip
    """Return the files of a document with other colours and positions; UsageError if textures cannot be converted."""
    target_format = kind.name
    if kind.is_own or kind.suffix is not None:
        return document.patch(colours, naming, images=images, places=places)
    if target_format in document.forms:
        return document.patch(colours, naming, images=images, places=places, form=target_format)
    if is_converted_with_textures(document, kind):
        if places is not None:
            raise UsageError(
                f"{document.name}: positions that --smooth-geometry moves cannot be converted together with textures; "
                f"give the output the extension .{document.format}"
            )
        mesh = with_images(document.textured_mesh(colours), images)
        mesh, notices = with_suffixes(mesh, registry.held_images(target_format) or ())
        stem = naming.free_stem(lambda stem: registry.textured_sidecars(mesh, target_format, stem))
        written = registry.write_textured(mesh, target_format, stem)
        return replace(written, notices=(*notices, *written.notices))
    if images or (document.slots() and not document.has_vertex_colours()):
        remedy = "end the name of the output in .glb, .gltf, .obj or .ply"
        raise UsageError(f"a .{target_format} file has no textures; {remedy}")
    contents = document.contents()
    if colours is not None:
        contents = replace(contents, colours=colours)
    if places is not None:
        normals = contents.normals
        if normals is not None and places.normals is not None:
            normals = np.where(np.isnan(places.normals), normals, places.normals)
        contents = replace(contents, positions=places.positions, normals=normals)
    stem = naming.free_stem(lambda stem: registry.sidecar_names(target_format, stem, None))
    return registry.write_contents(contents, target_format, stem)


def is_converted_with_textures(document: Document, kind: OutputFormat) -> bool:
    """Whether a document is written anew, as another format that can hold its textures."""
    if kind.is_own or kind.suffix is not None or kind.name in document.forms:
        return False
    return registry.held_images(kind.name) is not None and bool(document.readable(document.slots()))


def moved_vertices(document: Document, positions: Float64s) -> MovedVertices:
    """Return new positions, rows as in `painted`, with normals around moved vertices if every vertex has one."""
    painted = document.painted()
    if not document.has_normals_by_vertex():
        return MovedVertices(positions)
    # Copies of a vertex that share a normal share the new one; others stay separate, so that hard edges stay hard.
    columns = [*painted.positions.T, *document.attribute("normal").T]
    if painted.space_of is not None:
        columns.append(painted.space_of)
    group_of, _ = group_equal_rows(*columns)
    normals = vertex_normals(positions, painted.faces, group_of)
    moved = np.any(positions != painted.positions, axis=1)
    touched = np.zeros(int(group_of.max(initial=-1)) + 1, bool)
    touched[group_of[painted.faces[moved[painted.faces].any(axis=1)]]] = True
    normals[~touched[group_of] | ~normals.any(axis=1)] = np.nan
    return MovedVertices(positions, normals)


def naming_of(
    document: Document, source: str, target: str, output: Output | None, access: Access,
    others: dict[str, None] | None = None,
) -> Naming:  # fmt: skip
    """Return how the files beside an output are named; files of something else that are in the way go to `others`."""
    folder = None if output is None else output.folder
    keeps = "-" not in (source, target) and Path(source).resolve() == Path(os.path.realpath(target))
    if output is not None and keeps:
        output.replaceable = frozenset(document.references())

    def is_taken(name: str) -> bool:
        if output is None or folder is None or not os.path.lexists(folder / name):
            return False
        if not output.replaceable:
            with suppress(BeltramiError):  # there may be no output yet, or none that names files
                there = registry.open_document(target, replace(access, note=None))
                output.replaceable = frozenset(there.references())
        if name in output.replaceable:
            return False
        if others is not None:
            others[name] = None
        return True

    return Naming(Path(target).stem, keeps, is_moved(source, target), is_taken)


def _names(
    naming: Naming, document: Document, selection: Selection, settings: SmoothSettings, kind: OutputFormat
) -> list[str]:
    """Find the files that would be written beside the output, by writing the old images anew."""
    suffix = settings.textures.image_suffix
    images = {
        (slot, texture.key): ImageFile(
            # Other bytes, since what is equal is not written anew; each its own.
            f"new {texture.key}".encode(),
            suffix or suffix_for(texture.data, texture.name) or ".png",
        )
        for slot in selection.slots
        for texture in choose_textures(document.textured(slot), settings.textures).textures
    }
    if is_converted_with_textures(document, kind):
        held = registry.held_images(kind.name) or ()
        mesh = as_if_with_suffixes(with_images(document.textured_mesh(), images), held)
        stem = naming.free_stem(lambda stem: registry.textured_sidecars(mesh, kind.name, stem))
        return registry.textured_sidecars(mesh, kind.name, stem)
    written = make_files(document, None, images, kind, naming)
    return [*written.sidecars, *written.copies]


def is_moved(source: str, target: str) -> bool:
    """Whether the output is in another folder than the source."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent
