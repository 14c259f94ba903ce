"""One file of a batch: the task, its execution, and the outcome."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
import traceback
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from beltrami_cli.batch.storage import hash_at, staged
from beltrami_cli.errors import BeltramiError, MemoryLimitError, NoColoursError
from beltrami_cli.flow.noise_amount import noise_size
from beltrami_cli.formats.access import Access, is_url
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import Progress, Share
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.jobs.writing.output import FileSet
from beltrami_cli.surface.memory import limited_memory

if TYPE_CHECKING:
    from beltrami_cli.flow.chunks import Chunking
    from beltrami_cli.jobs.smooth_report import SmoothReport
    from beltrami_cli.layers.settings import SmoothSettings


Status = Literal["started", "done", "skipped", "uncoloured", "failed", "not started"]


@dataclass(frozen=True)
class Item:
    """A file to be smoothed; it can be sent to another process."""

    source: str
    target: str
    settings: SmoothSettings
    unwrap: BakeSettings | None = None
    outside: bool = False  # whether files outside the model's folder may be read
    overwrite: bool = False
    skip_uncoloured: bool = False  # whether a file without the selected colours is skipped instead of failing
    columns: tuple[str, ...] = ()  # names of the columns of points in text files
    # Whether an interrupted attempt may have written files; existing ones must then be equal.
    again: bool = False

    @property
    def parameters(self) -> str:
        """Hash of the settings and the program version, on which the result depends besides the files."""
        settings = dataclasses.asdict(self.settings)
        del settings["kernel"]["threads"]  # the result is the same for any number
        unwrap = None if self.unwrap is None else dataclasses.asdict(self.unwrap)
        everything = [version("beltrami-cli"), settings, unwrap, self.outside]
        if self.columns:
            everything.append({"columns": self.columns})
        return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """The outcome of one file; as JSON it is a line of the record."""

    input: str
    output: str
    status: Status  # "skipped": the result of an earlier run is still valid
    parameters_sha256: str = ""
    time: float = field(default_factory=time.time)  # of writing this outcome, in seconds since 1970
    seconds: float = 0.0
    error: str = ""
    exit_code: int = 0  # the same as that of `beltrami smooth` for this file
    read: dict[str, str] = field(default_factory=dict)  # SHA-256 of every file that was read, by its name
    written: dict[str, str] = field(default_factory=dict)
    report: dict[str, Any] | None = None  # of `beltrami smooth`

    def figures(self) -> tuple[float, float, bool] | None:
        """Return the strongest noise, the largest mean change, and whether no iterations were chosen."""
        report = self.report or {}
        parts = [
            each
            for each in (report.get("vertices"), report.get("image"), *report.get("textures", ()))
            if each
        ]
        if self.status == "failed" or not parts:
            return None
        noise = max(map(noise_size, parts))
        is_chosen = "iterations" in report.get("parameters", {}).get("free", ())
        is_left = is_chosen and not any(part["iterations"] for part in parts)
        return noise, max(float(part["change"]["mean"]) for part in parts), is_left


@dataclass(frozen=True)
class Attempt:
    """The answer of a worker: the outcome, whether more memory might help, and the traceback of an unexpected error."""

    outcome: Outcome
    wants_memory: bool = False
    traceback: str = ""
    pieces: int = 0  # most chunks of a surface of the file; 0: no surface was cut


def outcome_of(item: Item, status: Status, **values: Any) -> Outcome:
    return Outcome(item.source, item.target, status, parameters_sha256=item.parameters, **values)


def failed(item: Item, error: str, exit_code: int, seconds: float = 0.0) -> Outcome:
    return outcome_of(item, "failed", seconds=round(seconds, 3), error=error, exit_code=exit_code)


def do_item(
    item: Item, memory: int | None, progress: Progress | None = None, *,
    is_alone: bool = True, local: Item | None = None, chunking: Chunking | None = None,
) -> Attempt:  # fmt: skip
    """Smooth one file; a failure is returned, not raised. Only if the process `is_alone` can its memory be limited.

    `local`: the item by its names on this machine.
    """
    start = time.monotonic()
    try:
        with limited_memory(memory if is_alone else None, item.source):
            done = _done(item, local or item, memory, progress, chunking)
        return Attempt(dataclasses.replace(done, seconds=round(time.monotonic() - start, 3)))
    except BeltramiError as error:
        is_named = error.name in (item.source, item.target)
        message = str(error) if is_named else f"{item.source}: {error}"
        outcome = failed(item, message, error.exit_code, time.monotonic() - start)
        if item.skip_uncoloured and isinstance(error, NoColoursError):
            outcome = dataclasses.replace(outcome, status="uncoloured")
        return Attempt(outcome, isinstance(error, MemoryLimitError))
    except Exception as error:  # a bug, too, is a failure of this file only
        cause = " ".join(f"{item.source}: unexpected error: {type(error).__name__}: {error}".split())
        message = f"{cause}; run again with -vv and report it"
        return Attempt(failed(item, message, 1, time.monotonic() - start), traceback=traceback.format_exc())


def _done(
    item: Item, local: Item, memory: int | None, progress: Progress | None, chunking: Chunking | None
) -> Outcome:
    to_url = is_url(local.target)
    with staged(local.source, local.target) as stage:
        copy = dataclasses.replace(
            local, source=stage.source, target=stage.target,
            overwrite=local.overwrite or to_url, again=local.again and not to_url,
        )  # fmt: skip
        try:
            # Files that the source refers to are downloaded when they are first looked for.
            access = Access(local.outside, memory, stage.note, stage.bring, columns=local.columns)
            report = _smoothed(copy, access, progress, chunking)
        except BeltramiError as error:
            named = {stage.source: item.source, stage.target: item.target}
            error.name = named.get(error.name, error.name)
            error.args = (str(error).replace(stage.source, item.source).replace(stage.target, item.target),)
            raise
        sidecars = report.written[1:]
        names = [item.target, *sidecars]
        report = dataclasses.replace(report, input=item.source, output=item.target, written=names)
        if to_url:
            written = stage.send(sidecars, overwrite=local.overwrite, again=local.again)
        else:
            output = Path(os.path.realpath(local.target))
            files = (output, *(output.parent / name for name in sidecars))
            written = {str(file): hash_at(str(file)) for file in files}
        return outcome_of(item, "done", read=stage.read, written=written, report=dataclasses.asdict(report))


def _forwarded(progress: Progress, label: str, share: float) -> None:
    progress(label, round(1000 * share), 1000)


def _smoothed(
    item: Item, access: Access, progress: Progress | None, chunking: Chunking | None
) -> SmoothReport:
    from beltrami_cli.jobs.smooth import smooth_file

    with FileSet() as files:
        whole = None if progress is None else Share(forward=partial(_forwarded, progress))
        job = Job(access, whole, item.overwrite or item.again, files=files, chunking=chunking)
        report = smooth_file(item.source, item.target, item.settings, job, unwrap=item.unwrap)
        if item.again and not item.overwrite:
            files.keep_equal()
        files.commit()
    return report
