"""A job on one file: open it, choose the format and the names of the output, write that, and report it.

Other models in the output's folder that refer to a file which is replaced are named in a notice. The heads of their
files are searched for its name, and not parsed, so that a folder of large models takes little time.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from urllib.parse import quote

from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.fields import given_options
from beltrami_cli.formats import registry
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_regular, read_source
from beltrami_cli.formats.document import Document, Naming, Written
from beltrami_cli.formats.registry import (
    OUTPUT_FORMATS,
    OutputFormat,
    choose_format,
    held_images,
    is_only_read,
)
from beltrami_cli.jobs.job import Job, Stopwatch, peak_memory
from beltrami_cli.jobs.output import Output
from beltrami_cli.layers.settings import SmoothSettings


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
    job: Job  # whose access records files as read, so that nothing but OUTPUT replaces them
    document: Document
    format: OutputFormat
    output: Output | None  # None on a dry run
    watch: Stopwatch
    occupied: dict[str, None] = field(default_factory=dict)  # names in OUTPUT's folder that other models have

    def reserve(self, sidecars: Callable[[Naming], Iterable[str]]) -> Naming:
        """Return how the output's sidecar files are named; OutputError if one of them may not be written."""
        if self.job.check is not None:
            self.job.check(self.document)
        naming = _naming_of(self)
        names = sidecars(naming)
        if self.output is not None:
            self.output.check_sidecars(names)
        return naming

    def reserve_new(self, image_suffix: str | None) -> str:
        """Return an unused stem for the sidecar files of a new mesh with one texture, or none."""

        def names(stem: str) -> list[str]:
            return registry.sidecar_names(self.format.name, stem, image_suffix)

        return self.reserve(lambda naming: names(naming.free_stem(names))).free_stem(names)

    def write(self, files: Written, notices: Iterable[str], warnings: Iterable[str] = ()) -> FileReport:
        """Write the files, unless it is a dry run; `notices` are about the file, `warnings` about what was computed."""
        with self.watch.stage("write"):
            folder, access = Path(self.source).parent, self.job.access
            copied = {new: read_source(str(folder / old), access) for new, old in files.copies.items()}
            files = replace(files, sidecars={**files.sidecars, **copied})
            shared, names = self._notices_of_sharing(files.sidecars), list[str]()
            if self.output is not None:
                self.output.write(files)
                names = [self.target, *files.sidecars]
        # Several slots say the same of one surface.
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
    watch, (output, access) = Stopwatch(), job.output(target, settings.files_besides(source))
    job.begin("reading")
    with watch.stage("read"):
        document = open_input(source, settings, access)
        if models_only and document.kind == "image":
            document.painted()  # raises the error that it is no model
        kind = choose_format(document, target, job.format)
    return FileJob(source, target, replace(job, access=access), document, kind, output, watch)


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as a document; errors if it is unsupported, or no level set."""
    document = open_any(source, settings, access)
    require_level_set(settings, document)
    return document


def require_level_set(settings: SmoothSettings, *documents: Document) -> None:
    """Raise UsageError if options of level sets are given, and none of the documents is one."""
    wrong = given_options(settings.level_set)
    if wrong and all(document.kind != "volume" for document in documents):
        raise UsageError(f"{', '.join(wrong)}: for level sets, and {documents[0].name} is none")


def open_any(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a file as `open_input`, whether or not options of level sets mean anything for it."""
    data = read_source(source, access)
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    line = registry.recognised(data, name)
    if line is not None and line.kind == "volume":
        from beltrami_cli.layers.voxels import read_level_set

        return read_level_set(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    return registry.open_as(line, data, name, folder, access)


def _naming_of(file: FileJob) -> Naming:
    source, target, output = file.source, file.target, file.output
    folder = None if output is None else output.folder
    keeps = "-" not in (source, target) and Path(source).resolve() == Path(os.path.realpath(target))
    if output is not None and keeps:
        output.replaceable = frozenset(file.document.references())

    def is_taken(name: str) -> bool:
        if output is None or folder is None or not os.path.lexists(folder / name):
            return False
        if not output.replaceable:
            with suppress(BeltramiError):  # there may be no output yet, or none that names files
                there = registry.open_document(target, replace(file.job.access, note=None))
                output.replaceable = frozenset(there.references())
        if name in output.replaceable:
            return False
        file.occupied[name] = None
        return True

    return Naming(Path(target).stem, keeps, is_moved(source, target), is_taken)


def is_moved(source: str, target: str) -> bool:
    """Whether the output is in another folder than the source."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent


_MOST_FILES = 1000
# Bytes of each file. OBJ and PLY name their files in front of the vertices; materials and the JSON of glTF are short,
# unless buffers are written into them.
_HEAD = 1 << 18
_MOST_NAMED = 3  # models in one line
_LIBRARY = ".mtl"


def shared_files(folder: Path, target: Path, names: Iterable[str]) -> list[str]:
    """Return a notice if models in a folder, other than the target, refer to existing files of these names."""
    replaced = [name for name in names if os.path.lexists(folder / name)]
    heads = _heads(folder, {target.name, *replaced}) if replaced else {}
    libraries = [name for name in heads if name.endswith(_LIBRARY) and _refers(heads[name], replaced)]
    users = [
        name
        for name in heads
        if not name.endswith(_LIBRARY) and _refers(heads[name], [*replaced, *libraries])
    ]
    if not users:
        return []
    more = f" and {len(users) - _MOST_NAMED} more" if len(users) > _MOST_NAMED else ""
    models = f"{', '.join(users[:_MOST_NAMED])}{more}"
    return [f"replaced {', '.join(replaced)}, which other models in the folder show, too: {models}."]


def _heads(folder: Path, left_out: set[str]) -> dict[str, bytes]:
    found = {}
    with os.scandir(folder) as entries:
        names = (entry.name for entry in entries if entry.name not in left_out)
        for name in sorted(islice(filter(_may_refer, names), _MOST_FILES)):
            try:
                found[name] = read_regular(folder / name, EVERYTHING_INSIDE, _HEAD)
            except OSError:
                continue
    return found


def _may_refer(name: str) -> bool:
    suffix = Path(name).suffix.lower().removeprefix(".")
    if suffix in OUTPUT_FORMATS:
        return held_images(OUTPUT_FORMATS[suffix]) is not None
    return f".{suffix}" == _LIBRARY or is_only_read(suffix)


def _refers(text: bytes, names: Iterable[str]) -> bool:
    """Whether a text names one of some files, as a whole word; URIs may have escapes."""
    spelled = {os.fsencode(each) for name in names for each in (name, quote(name))}
    words = b"|".join(map(re.escape, sorted(spelled)))
    return (
        bool(words) and re.search(rb"(?:^|[\s\"'@>]|\./)(?:" + words + rb")(?=$|[\s\"'@<])", text) is not None
    )
