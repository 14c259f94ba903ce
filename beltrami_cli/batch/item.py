"""One file of a batch: the task, its execution, the outcome, and the record of all, from which a later run resumes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from beltrami_cli.batch.storage import exists, hash_at, place_of, require_name, staged
from beltrami_cli.errors import BeltramiError, InputError, MemoryLimitError, OutputError, UnpaintedError
from beltrami_cli.formats.access import (
    Access,
    is_there,
    is_url,
    limited_memory,
    open_regular,
    parse_json,
    unreadable,
)
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.output import FileSet, Output
from beltrami_cli.jobs.progress import Progress, Share
from beltrami_cli.jobs.settings import BakeSettings

if TYPE_CHECKING:
    from beltrami_cli.flow.chunks import Chunking
    from beltrami_cli.jobs.smoothing import SmoothReport
    from beltrami_cli.layers.settings import SmoothSettings


Status = Literal["started", "done", "skipped", "uncoloured", "failed", "not started"]


@dataclass(frozen=True)
class Item:
    """A file to be smoothed; it can be sent to another process."""

    source: str
    target: str
    settings: SmoothSettings
    unwrap: BakeSettings | None = None
    outside: bool = False  # whether files are followed that the model names beyond its own folder
    overwrite: bool = False
    skip_uncoloured: bool = False  # whether a file without the colours that are asked for is no failure
    columns: tuple[str, ...] = ()  # names of the columns of points in text files
    # Whether an attempt that was cut off may have written files; existing ones must then be equal.
    again: bool = False

    @property
    def parameters(self) -> str:
        """Hash of all that the result depends on besides the files: the settings and the version of this program."""
        settings = dataclasses.asdict(self.settings)
        del settings["kernel"]["threads"]  # the result is the same for any number
        unwrap = None if self.unwrap is None else dataclasses.asdict(self.unwrap)
        everything = [version("beltrami-cli"), settings, unwrap, self.outside]
        if self.columns:
            everything.append({"columns": self.columns})
        return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """What came of one file; as JSON it is a line of the record."""

    input: str
    output: str
    status: Status  # "skipped": what an earlier run did still holds
    parameters_sha256: str = ""
    time: float = field(default_factory=time.time)  # when this was written, in seconds since 1970
    seconds: float = 0.0
    error: str = ""
    exit_code: int = 0  # that of `beltrami smooth` for the same file
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
        noise = max((float(value) for part in parts for value in part["noise"].values()), default=0.0)
        is_chosen = "iterations" in report.get("parameters", {}).get("free", ())
        is_left = is_chosen and not any(part["iterations"] for part in parts)
        return noise, max(float(part["change"]["mean"]) for part in parts), is_left


@dataclass(frozen=True)
class Attempt:
    """What a worker answers: the outcome, whether more memory might help, and where an unforeseen error arose."""

    outcome: Outcome
    wants_memory: bool = False
    traceback: str = ""
    pieces: int = 0  # at most, of a surface of the file; 0: none was cut


def outcome_of(item: Item, status: Status, **values: Any) -> Outcome:
    """Return an outcome with the names and parameters of an item."""
    return Outcome(item.source, item.target, status, parameters_sha256=item.parameters, **values)


def failed(item: Item, error: str, exit_code: int, seconds: float = 0.0) -> Outcome:
    """Return the outcome of an item that failed."""
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
        message = str(error)
        if item.source not in message and item.target not in message:
            message = f"{item.source}: {message}"
        outcome = failed(item, message, error.exit_code, time.monotonic() - start)
        if item.skip_uncoloured and isinstance(error, UnpaintedError):
            outcome = dataclasses.replace(outcome, status="uncoloured")
        return Attempt(outcome, isinstance(error, MemoryLimitError))
    except Exception as error:  # even a mistake of ours is of this file only
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
            # A file that the source names is downloaded as soon as it is looked for.
            access = Access(local.outside, memory, stage.note, stage.bring, columns=local.columns)
            report = _made(copy, access, progress, chunking)
        except BeltramiError as error:
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


def _made(item: Item, access: Access, progress: Progress | None, chunking: Chunking | None) -> SmoothReport:
    from beltrami_cli.jobs.smooth import smooth_file

    with FileSet() as files:
        whole = None if progress is None else Share(forward=partial(_forwarded, progress))
        job = Job(access, whole, item.overwrite or item.again, files=files, chunking=chunking)
        report = smooth_file(item.source, item.target, item.settings, job, unwrap=item.unwrap)
        if item.again and not item.overwrite:
            files.keep_equal()
        files.put_in_place()
    return report


_HEAD = re.compile(rb'\{"input": ".*", "output": ".*", "status": "')
_START = b'{"input": "'
_LONGEST = 1 << 26  # bytes of a line
_SHA256 = re.compile(r"[0-9a-f]{64}")
# Of lines that are not from a report.
_UNFIT = (ValueError, TypeError, LookupError, AttributeError, OverflowError)


class Record:
    """A report as it grows: a line when a file is started, and one when it is finished.

    `resume`: go on from an earlier report; InputError if it cannot be read.
    `overwrite`: replace a record; any other file stays, as it may be a part of a model.
    """

    def __init__(self, path: str, *, resume: bool, overwrite: bool) -> None:
        self.path = path
        if not resume and not overwrite and is_there(path):
            raise OutputError(path, "exists already", "--resume goes on from it, --overwrite starts again")
        self._output = Output(
            path,
            overwrite=resume or (overwrite and "own"),
            what="report",
            is_own=lambda head: _HEAD.match(head) is not None,
        )
        self._latest = _read_record(path) if resume and is_there(path) else {}
        self.close([])  # without the line that the end of a run cut off
        self._output.overwrite = True  # from now on it is ours

    def latest(self, item: Item) -> Outcome | None:
        return self._latest.get(place_of(item.target))

    def add(self, outcome: Outcome) -> None:
        """Write a line, and wait until it is on the disk."""
        self._latest[place_of(outcome.output)] = outcome
        try:
            with Path(self.path).open("a", encoding="utf-8") as file:
                file.write(_line(outcome))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(self.path, f"cannot be written ({error.strerror})", "free space") from error

    def close(self, outcomes: Iterable[Outcome]) -> None:
        """Rewrite the report with one line per file: earlier files first, then this run's in order."""
        now = {place_of(outcome.output): outcome for outcome in outcomes}
        earlier = {place: outcome for place, outcome in self._latest.items() if place not in now}
        lines = [_line(each).encode() for each in (*earlier.values(), *now.values())]
        self._output.write(Written(main=lines))


def is_done(item: Item, outcome: Outcome | None) -> bool:
    """Whether an earlier run did the item, and nothing that it depends on has changed since."""
    if outcome is None or outcome.status not in ("done", "skipped"):
        return False
    same = outcome.parameters_sha256 == item.parameters and place_of(item.source) == place_of(outcome.input)
    return same and _holds(outcome.read) and _holds(outcome.written)


def is_ours(outcome: Outcome | None) -> bool:
    """Whether the files at the place of an output are as an earlier run left them, and may be replaced."""
    if outcome is None or place_of(outcome.output) not in outcome.written:
        return False
    return _holds({name: digest for name, digest in outcome.written.items() if exists(name)})


def _holds(hashes: dict[str, str]) -> bool:
    try:
        return all(hash_at(name) == digest for name, digest in hashes.items())
    except OSError:
        return False


def _line(outcome: Outcome) -> str:
    return json.dumps(dataclasses.asdict(outcome)) + "\n"


def _read_record(path: str) -> dict[str, Outcome]:
    """Return the last line of each output; the very last line may be cut off by the end of a run."""
    latest: dict[str, Outcome] = {}
    try:
        with open_regular(Path(path)) as file:
            for number, line in enumerate(iter(partial(file.readline, _LONGEST), b""), 1):
                try:
                    outcome = _outcome_in(line)
                except _UNFIT:
                    is_cut_off = line[: len(_START)] == _START[: len(line)] and not line.endswith(b"\n")
                    if is_cut_off and not file.read(1):
                        break
                    cause = f"line {number} is not of a report of beltrami batch"
                    raise InputError(path, cause, "leave out --resume, or choose another --report") from None
                latest.pop(place_of(outcome.output), None)
                latest[place_of(outcome.output)] = outcome
    except OSError as error:
        raise unreadable(path, error) from error
    return latest


def _outcome_in(line: bytes) -> Outcome:
    """Return what a line says; an error of `_UNFIT` if it cannot be from `_line`."""
    outcome = Outcome(**parse_json(line))
    source, target = require_name(outcome.input), require_name(outcome.output)
    outcome.figures()  # which the table shows
    report = outcome.report or {}
    texts = (outcome.parameters_sha256, outcome.error, *report.get("warnings", ()))
    is_valid = (
        outcome.status in get_args(Status)
        and all(isinstance(text, str) for text in texts)
        and all(_is_number(number) and number >= 0 for number in (outcome.time, outcome.seconds))
        and type(outcome.exit_code) is int
        and _are_hashes(outcome.read, source)
        and _are_hashes(outcome.written, target)
        and isinstance(outcome.report, dict | None)
        and isinstance(report.get("textures", []), list)
    )
    if not is_valid:
        raise ValueError("a value is of another kind, or out of its range")
    return outcome


def _are_hashes(values: object, file: str) -> bool:
    """Return whether values are SHA-256 by name; URLs among the names are below the folder of the file's URL."""
    folder = file.rpartition("/")[0]

    def is_below(url: str) -> bool:  # "::" would chain another URL to it
        return url.startswith(f"{folder}/") and "::" not in url[len(folder) :]

    return isinstance(values, dict) and all(
        isinstance(digest, str)
        and _SHA256.fullmatch(digest)
        and (not is_url(require_name(name)) or (is_url(file) and is_below(name)))
        for name, digest in values.items()
    )


def _is_number(value: object) -> bool:
    """Whether a value is a number that floats can hold."""
    return isinstance(value, float) or (type(value) is int and abs(value) < 1 << 63)
