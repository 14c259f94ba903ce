"""A job on one file: open it, choose format and names of the output, write and report."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats import output_format, registry
from beltrami_cli.formats.changes import Naming, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access, read_source
from beltrami_cli.formats.output_format import OutputFormat, choose_format
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.jobs.writing.shared_files import shared_files
from beltrami_cli.jobs.writing.sidecars import SidecarNames
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.memory import peak_memory


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
    parameters: dict[str, object]
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
    sidecars: SidecarNames
    watch: Stopwatch

    @property
    def is_moved(self) -> bool:
        """Whether output and source are in different folders."""
        if "-" in (self.source, self.target):
            return self.source != "-"
        return Path(self.source).resolve().parent != Path(os.path.realpath(self.target)).parent

    @property
    def naming(self) -> Naming:
        """How sidecar files are named, without names that other models use; a dry run looks for none."""
        in_place = _is_in_place(self.source, self.target)
        return Naming(Path(self.target).stem, in_place, self.is_moved, self.sidecars.note_if_taken)

    def reserve(self, sidecars: Iterable[str]) -> None:
        """Check the names of sidecar files before anything is computed; OutputError if one is refused."""
        if self.output is not None:
            self.output.reserve_sidecars(sidecars)

    def reserve_new(self, image_suffix: str | None) -> str:
        """Return an unused stem for the sidecar files of a new mesh with one texture or no texture."""
        names = partial(output_format.usual_sidecars, self.format.name, image_suffix=image_suffix)
        stem = self.naming.free_stem(names)
        self.reserve(names(stem))
        return stem

    def write(
        self, files: Written, parameters: dict[str, object], notices: Iterable[str],
        warnings: Iterable[str] = (),
    ) -> FileReport:  # fmt: skip
        """Write the files, unless it is a dry run; `notices` concern the file, `warnings` the computation."""
        with self.watch.stage("write"):
            folder, access = Path(self.source).parent, self.job.access
            copied = {new: read_source(str(folder / old), access) for new, old in files.copies.items()}
            files = replace(files, sidecars={**files.sidecars, **copied})
            shared, names = self._notices_of_sharing(files.sidecars), list[str]()
            if self.output is not None:
                self.output.write(files, self.sidecars)
                names = [self.target, *files.sidecars]
        # Several slots repeat the warnings about their surface.
        notices = dict.fromkeys([*self.document.notices, *notices, *shared, *files.notices])
        return FileReport(
            input=self.source, output=self.target, format=self.format.name, parameters=parameters,
            stages=self.watch.stages, written=names, warnings=[*notices, *warnings],
        )  # fmt: skip

    def _notices_of_sharing(self, sidecars: Iterable[str]) -> list[str]:
        if self.output is None:
            return []
        notices = list[str]()
        if self.sidecars.taken:
            taken = f"another model in OUTPUT's folder has {', '.join(self.sidecars.taken)}"
            notices.append(f"{taken}; the new files have a number in their names.")
        if self.output.folder is not None and self.output.overwrite:
            notices += shared_files(self.output.folder, self.output.path, sidecars)
        return notices


def open_file_job(
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
    sidecars = SidecarNames(
        folder=None if output is None else output.folder,
        read=partial(_references, target, access),
        read_first=partial(_references_of, document) if _is_in_place(source, target) else None,
    )
    return FileJob(source, target, replace(job, access=access), document, kind, output, sidecars, watch)


def _references(name: str, access: Access) -> frozenset[str]:
    """Read the names of the sidecar files of an existing output; none if it cannot be read."""
    unwatched = replace(access, hooks=replace(access.hooks, on_read=None))
    with suppress(BeltramiError):
        return _references_of(registry.open_document(name, unwatched))
    return frozenset()


def _references_of(document: Document) -> frozenset[str]:
    return frozenset(document.references())


def _is_in_place(source: str, target: str) -> bool:
    return "-" not in (source, target) and Path(source).resolve() == Path(os.path.realpath(target))
