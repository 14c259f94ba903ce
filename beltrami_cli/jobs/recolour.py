"""Recolour a file: open it, choose format and names of the output, select layers, filter them, write, report.

A filter gives a layer new colours: by the kernel, by adding noise, and the like. No code here asks which layers they
are. The files of the result have the format that the output asks for; in memory, the result is a document to look at.
"""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.fields import given_parameters
from beltrami_cli.formats import registry
from beltrami_cli.formats.access import Access, read_source
from beltrami_cli.formats.changes import Naming, Written
from beltrami_cli.formats.colours import as_in_file
from beltrami_cli.formats.conversion import vertex_mesh
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.file_formats import suffix_for
from beltrami_cli.formats.image_document import ImageDocument
from beltrami_cli.formats.registry import OutputFormat, choose_format
from beltrami_cli.formats.textured_mesh import with_images, with_suffixes
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import phases_of
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.jobs.writing.shared_files import shared_files
from beltrami_cli.layers.layer import Layer, StoredColours, all_images
from beltrami_cli.layers.selection import Selection, select
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.memory import peak_memory
from beltrami_cli.surface.records import ImageFile, MovedVertices, PlannedImage, Slot


class Stopwatch:
    """Sums the time of named stages."""

    def __init__(self) -> None:
        # "wall" and "cpu" seconds (all threads of the process), in the order of their start.
        self.stages: dict[str, dict[str, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        wall, cpu = time.perf_counter(), time.process_time()
        times = self.stages.setdefault(name, {"wall": 0.0, "cpu": 0.0})
        try:
            yield
        finally:
            times["wall"] += time.perf_counter() - wall
            times["cpu"] += time.process_time() - cpu


@dataclass(frozen=True, kw_only=True)
class FileReport:
    """The report of a written file; `SmoothReport` describes its fields."""

    input: str
    output: str
    format: str
    parameters: dict[str, object] = field(default_factory=dict)
    stages: dict[str, dict[str, float]] = field(default_factory=dict)
    peak_memory: int | None = field(default_factory=peak_memory)
    written: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class FileJob:
    """A job on one file: the opened source, and where the output goes in which format."""

    source: str
    target: str
    job: Job  # its access records files as read, so that only OUTPUT may replace them
    document: Document
    format: OutputFormat
    output: Output | None  # None on a dry run
    watch: Stopwatch
    occupied: dict[str, None] = field(default_factory=dict)  # names in OUTPUT's folder that other models use

    def reserve(self, sidecars: Callable[[Naming], Iterable[str]]) -> Naming:
        """Return the naming of the output's sidecar files; OutputError if one of them must not be written."""
        if self.job.check is not None:
            self.job.check(self.document)
        naming = _naming_of(self)
        names = sidecars(naming)
        if self.output is not None:
            self.output.check_sidecars(names)
        return naming

    def reserve_new(self, image_suffix: str | None) -> str:
        """Return an unused stem for the sidecar files of a new mesh with one texture or no texture."""

        def names(stem: str) -> list[str]:
            return registry.sidecar_names(self.format.name, stem, image_suffix)

        return self.reserve(lambda naming: names(naming.free_stem(names))).free_stem(names)

    def write(self, files: Written, notices: Iterable[str], warnings: Iterable[str] = ()) -> FileReport:
        """Write the files, unless it is a dry run; `notices` concern the file, `warnings` the computation."""
        with self.watch.stage("write"):
            folder, access = Path(self.source).parent, self.job.access
            copied = {new: read_source(str(folder / old), access) for new, old in files.copies.items()}
            files = replace(files, sidecars={**files.sidecars, **copied})
            shared, names = self._notices_of_sharing(files.sidecars), list[str]()
            if self.output is not None:
                self.output.write(files)
                names = [self.target, *files.sidecars]
        # Several slots repeat the warnings about their surface.
        notices = dict.fromkeys([*self.document.notices, *notices, *shared, *files.notices])
        return FileReport(
            input=self.source,
            output=self.target,
            format=self.format.name,
            stages=self.watch.stages,
            written=names,
            warnings=[*notices, *warnings],
        )

    def _notices_of_sharing(self, sidecars: Iterable[str]) -> list[str]:
        notices = []
        if self.occupied:
            names = ", ".join(self.occupied)
            notices.append(
                f"another model in OUTPUT's folder has {names}; the new files have a number in their names."
            )
        if self.output is not None and self.output.folder is not None and self.output.overwrite:
            notices += shared_files(self.output.folder, self.output.path, sidecars)
        return notices


def begin(
    source: str, target: str, settings: SmoothSettings, job: Job, *, models_only: bool = False
) -> FileJob:
    """Open a source, and choose where the output goes in which format; UsageError or OutputError if it cannot."""
    watch, output, access = Stopwatch(), None, job.access
    if not job.dry_run:
        output = Output(target, overwrite=job.overwrite, files=job.files)
        output.files.guard(settings.input_files(source))
        access = output.files.watching(access)
    job.begin("reading")
    with watch.stage("read"):
        document = open_input(source, settings, access)
        if models_only and document.kind == "image":
            document.coloured_vertices()  # raises an error: it is not a model
        kind = choose_format(document, target, job.format)
    return FileJob(source, target, replace(job, access=access), document, kind, output, watch)


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as a document; errors if it is unsupported, or no level set."""
    document = open_any(source, settings, access)
    require_level_set(settings, document)
    return document


def require_level_set(settings: SmoothSettings, *documents: Document) -> None:
    """Raise UsageError if options of level sets are given, and none of the documents is one."""
    wrong = [each.flag for each in given_parameters(settings.level_set)]
    if wrong and all(document.kind != "volume" for document in documents):
        raise UsageError(f"{', '.join(wrong)} need a level set, and {documents[0].name} is not one")


def open_any(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a file as `open_input`, and allow options of level sets for any file."""
    data, access = read_source(source, access), replace(access, channels=settings.channels or ())
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    line = registry.recognised(data, name)
    if line is not None and line.kind == "volume":
        from beltrami_cli.layers.level_set import read_level_set

        return read_level_set(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    return registry.open_as(line, data, name, folder, access)


def _naming_of(file: FileJob) -> Naming:
    source, target, output = file.source, file.target, file.output
    folder = None if output is None else output.folder
    keeps = "-" not in (source, target) and Path(source).resolve() == Path(os.path.realpath(target))
    if output is not None and keeps:
        output.replaceable = frozenset(file.document.references())

    def references() -> frozenset[str]:
        with suppress(BeltramiError):  # the output may not exist, or may not be readable
            return frozenset(registry.open_document(target, replace(file.job.access, note=None)).references())
        return frozenset()

    if output is not None:
        output.references = references

    def is_taken(name: str) -> bool:
        if output is None or folder is None or not os.path.lexists(folder / name):
            return False
        output.replaceable = output.replaceable or references()
        if name in output.replaceable:
            return False
        file.occupied[name] = None
        return True

    return Naming(Path(target).stem, keeps, is_moved(source, target), is_taken)


def is_moved(source: str, target: str) -> bool:
    """Whether output and source are in different folders."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent


@dataclass(frozen=True, kw_only=True)
class FilterResult:
    """New colours of a layer; subclasses add figures for the report."""

    stored: StoredColours
    warnings: Sequence[str] = ()


AnyResult = TypeVar("AnyResult", bound=FilterResult)


class ColourFilter(ABC, Generic[AnyResult]):
    """Recolours layers. It is immutable: what it did is in its results."""

    # Whether image channels other than colours stay unchanged unless they are selected by name.
    colours_only: ClassVar[bool] = True
    # Whether large arrays may be stored in files if memory is short.
    works_in_files: ClassVar[bool] = True

    @property
    def phases(self) -> Sequence[str]:
        """Phases of `apply`, see `jobs/progress.py`."""
        return ("recolouring",)

    @property
    def changes(self) -> bool:
        """Whether it changes any colour; otherwise the output equals the input."""
        return True

    @property
    def works_in_groups(self) -> bool:
        """Whether textures without common edges are filtered separately."""
        return False

    def check(self, selection: Selection, target: OutputFormat) -> None:
        """Raise an error if the selection cannot be recoloured, before the computation."""

    @abstractmethod
    def apply(self, layer: Layer, job: Job) -> AnyResult:
        """Return new colours of a layer."""

    def check_results(self, source: str, results: Sequence[AnyResult]) -> None:
        """Raise an error if the results must not be written."""


def recolour(
    source: str, target: str, settings: SmoothSettings, colour_filter: ColourFilter[AnyResult], job: Job
) -> tuple[FileReport, list[AnyResult]]:
    """Recolour the selected parts of a file, and write it with everything else unchanged."""
    file = begin(source, target, settings, job)
    document, kind, watch = file.document, file.format, file.watch
    with watch.stage("read"):
        selection = select(document, settings, file.job.access)
        if not colour_filter.changes and kind.suffix is None:
            selection = Selection(document, settings, file.job.access)
        colour_filter.check(selection, kind)
        naming = file.reserve(partial(_sidecar_names, selection, kind))
    place = None if file.output is None else target
    with selection.within_memory(place, in_files=colour_filter.works_in_files) as chunk_memory:
        with watch.stage("smooth"):
            results = apply_filter(
                selection, colour_filter, replace(file.job, chunk_memory=chunk_memory), kind.suffix
            )
            colour_filter.check_results(source, results)
        with watch.stage("write"):
            new = [each.stored for each in results]
            images, said = all_images(new)
            written = _files(document, new, images, kind, naming, in_place=not is_moved(source, target))
        notices = [*selection.notices, *(notice for each in new for notice in each.notices), *said]
        report = file.write(written, notices, [warning for each in results for warning in each.warnings])
    return report, results


def recolour_in_memory(
    document: Document, settings: SmoothSettings, colour_filter: ColourFilter[AnyResult], job: Job
) -> tuple[Document, list[AnyResult]]:
    """Recolour the selected parts, and return the document that would be written; the given one is unchanged."""
    selection = Selection(document, settings, job.access)
    if colour_filter.changes:
        selection = select(document, settings, job.access)
    colour_filter.check(selection, OutputFormat(document.format, is_patched=True))
    with selection.within_memory(in_files=colour_filter.works_in_files) as chunk_memory:
        results = apply_filter(selection, colour_filter, replace(job, chunk_memory=chunk_memory))
    return with_new_colours(document, [each.stored for each in results]), results


def apply_filter(
    selection: Selection, colour_filter: ColourFilter[AnyResult], job: Job, suffix: str | None = None
) -> list[AnyResult]:
    """Recolour the selected parts, layer by layer; `suffix`: of the image format of the output, if it differs."""
    results = []
    counts = selection.samples()
    phases = [phases_of(["laying out", *colour_filter.phases], count) for count in counts]
    job.expect([*chain(*phases), *phases_of(["writing"], sum(counts))])
    job.begin("laying out")
    options = {"colours_only": colour_filter.colours_only, "in_groups": colour_filter.works_in_groups}
    for layer in selection.layers(suffix, **options):
        layer.require_writable()
        results.append(colour_filter.apply(layer, job))
        job.begin("laying out" if len(results) < len(counts) else "writing")
        del layer
    return results


def _files(
    document: Document, stored: Sequence[StoredColours], images: dict[tuple[Slot, str], ImageFile],
    kind: OutputFormat, naming: Naming, *, in_place: bool,
) -> Written:  # fmt: skip
    """Return the files of a document with new colours, images and positions, in the format of the output."""
    colours = next((each.colours for each in stored if each.colours is not None), None)
    places = next((each.positions for each in stored if each.positions is not None), None)
    moved = None if places is None else moved_vertices(document, places)
    if in_place:
        images = {key: image for key, image in images.items() if _is_new(document, *key, image)}
    if kind.is_patched:
        return document.patch(colours, naming, images=images, places=moved, form=kind.name)
    if _has_textures(document, kind):
        if moved is not None:
            raise UsageError(
                f"positions that --smooth-geometry moves cannot be converted together with textures; "
                f"give the output the extension .{document.format}",
                document.name,
            )
        mesh = with_images(document.textured_mesh(colours), images)
    else:
        mesh = vertex_mesh(document, colours)
    if moved is not None:
        normals = mesh.normals
        if normals is not None and moved.normals is not None:
            normals = np.where(np.isnan(moved.normals), normals, moved.normals)
        mesh = replace(mesh, positions=moved.positions, normals=normals)
    mesh, notices = with_suffixes(mesh, registry.image_suffixes(kind.name) or ())
    stem = naming.free_stem(partial(registry.sidecars_of, mesh, kind.name))
    written = registry.write_mesh(mesh, kind.name, stem)
    return replace(written, notices=(*notices, *written.notices))


def _is_new(document: Document, slot: Slot, key: str, image: ImageFile) -> bool:
    """Whether an image changed: in the source's folder, the output refers to the unchanged images of the source."""
    if slot not in document.slots():
        return True
    return all(image.data != each.data for each in document.textured(slot).textures if each.key == key)


def _has_textures(document: Document, kind: OutputFormat) -> bool:
    """Whether conversion of a document also converts textures."""
    return registry.image_suffixes(kind.name) is not None and bool(document.readable(document.slots()))


def moved_vertices(document: Document, positions: Float64s) -> MovedVertices:
    """Return new positions of coloured vertices, with normals around moved vertices if every vertex has one."""
    vertices = document.coloured_vertices()
    if not document.has_normals_by_vertex():
        return MovedVertices(positions)
    # Copies of a vertex with equal normals get equal new ones; others stay separate, so that hard edges stay hard.
    columns = [*vertices.positions.T, *document.attribute("normal").T]
    if vertices.space_of is not None:
        columns.append(vertices.space_of)
    group_of, _ = group_equal_rows(*columns)
    normals = vertex_normals(positions, vertices.faces, group_of)
    moved = np.any(positions != vertices.positions, axis=1)
    touched = np.zeros(int(group_of.max(initial=-1)) + 1, bool)
    touched[group_of[vertices.faces[moved[vertices.faces].any(axis=1)]]] = True
    normals[~touched[group_of] | ~normals.any(axis=1)] = np.nan
    return MovedVertices(positions, normals)


def _sidecar_names(selection: Selection, kind: OutputFormat, naming: Naming) -> list[str]:
    """Return the names of the output's sidecar files, as if all selected colours changed."""
    document, settings = selection.document, selection.settings
    chosen = settings.textures.image_suffix
    images: dict[tuple[Slot, str], PlannedImage] = {}
    for slot, surface in zip(selection.slots, selection.surfaces, strict=True):
        for texture in surface.textures:
            suffix = chosen or suffix_for(texture.data, texture.name) or ".png"
            images[slot, texture.key] = PlannedImage(suffix, is_chosen=chosen is not None, slot=slot)
    if kind.is_patched:
        moves = selection.vertices and settings.embedding.smooth_geometry
        changes = {"colours": selection.vertices, "places": moves}
        return document.sidecar_names(images, naming, form=kind.name, **changes)
    if _has_textures(document, kind):
        registry.require_textures(kind.name, chosen)
        mesh = with_images(document.textured_mesh(), images)
        names = partial(registry.sidecars_of, mesh, kind.name)
    elif images or (document.slots() and not document.has_vertex_colours()):
        remedy = "end the name of the output in .glb, .gltf, .obj or .ply"
        raise UsageError(f"a .{kind.name} file has no textures; {remedy}")
    else:
        names = partial(registry.sidecar_names, kind.name, image_suffix=None)
    return names(naming.free_stem(names))


def with_new_colours(document: Document, stored: Sequence[StoredColours]) -> Document:
    """Return the document as it would be with new colours, rounded to the precision of its file."""
    images = {key: image.data for key, image in all_images(stored)[0].items()}
    new = next((each for each in stored if each.colours is not None), None)
    if document.kind == "image":
        return ImageDocument(images.get(("baseColor", ""), document.data), document.name)
    if new is None or new.colours is None:
        return document.with_colours(None, images)
    vertices, colours = document.coloured_vertices(), new.colours
    colours = as_in_file(vertices, colours)
    positions = vertices.positions if new.positions is None else new.positions
    return document.with_colours(replace(vertices, colours=colours, positions=positions), images)
