"""The record of a batch, from which a later run resumes: a line for each started or finished file."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import get_args

from beltrami_cli.batch.item import Item, Outcome, Status
from beltrami_cli.batch.storage import canonical_name, exists, hash_at, require_name
from beltrami_cli.errors import InputError, OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.files.access import unreadable
from beltrami_cli.formats.files.bounded_text import parse_json
from beltrami_cli.formats.files.paths import is_there, is_url, open_regular
from beltrami_cli.jobs.writing.output import Output

_HEAD = re.compile(rb'\{"input": ".*", "output": ".*", "status": "')
_START = b'{"input": "'
_LONGEST = 1 << 26  # bytes of a line
_SHA256 = re.compile(r"[0-9a-f]{64}")
# Errors of lines that are not from a report.
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
        self._latest = read_outcomes(path) if resume and is_there(path) else {}
        self.close([])  # removes the incomplete line of an interrupted run

    def latest(self, item: Item) -> Outcome | None:
        return self._latest.get(canonical_name(item.target))

    def add(self, outcome: Outcome) -> None:
        """Write a line, and synchronise it to the disk."""
        self._latest[canonical_name(outcome.output)] = outcome
        try:
            with Path(self.path).open("a", encoding="utf-8") as file:
                file.write(_line(outcome))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(self.path, f"cannot be written ({error.strerror})", "free space") from error

    def close(self, outcomes: Iterable[Outcome]) -> None:
        """Rewrite the report with one line per file: earlier files first, then this run's in order."""
        now = {canonical_name(outcome.output): outcome for outcome in outcomes}
        earlier = {place: outcome for place, outcome in self._latest.items() if place not in now}
        lines = [_line(each).encode() for each in (*earlier.values(), *now.values())]
        self._output.write(Written(main=lines))


def is_done(item: Item, outcome: Outcome) -> bool:
    """Whether an earlier run completed the item, and all that it depends on is unchanged."""
    if outcome.status not in ("done", "skipped"):
        return False
    is_same_task = outcome.parameters_sha256 == item.parameters_sha256
    is_same_task &= canonical_name(outcome.input) == canonical_name(item.source)
    return is_same_task and _holds(outcome.read) and _holds(outcome.written)


def is_own_output(outcome: Outcome | None) -> bool:
    """Whether an output and its sidecars are as an earlier run wrote them, and so may be replaced."""
    if outcome is None or canonical_name(outcome.output) not in outcome.written:
        return False
    return _holds({name: digest for name, digest in outcome.written.items() if exists(name)})


def _holds(hashes: dict[str, str]) -> bool:
    try:
        return all(hash_at(name) == digest for name, digest in hashes.items())
    except OSError:
        return False


def _line(outcome: Outcome) -> str:
    return json.dumps(dataclasses.asdict(outcome)) + "\n"


def read_outcomes(path: str) -> dict[str, Outcome]:
    """Return the last line of each output; the last line of the file may be incomplete after an interruption."""
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
                latest.pop(canonical_name(outcome.output), None)
                latest[canonical_name(outcome.output)] = outcome
    except OSError as error:
        raise unreadable(path, error) from error
    return latest


def _outcome_in(line: bytes) -> Outcome:
    """Parse a line; an error of `_UNFIT` if it was not written by `_line`."""
    outcome = Outcome(**parse_json(line))
    source, target = require_name(outcome.input), require_name(outcome.output)
    outcome.figures()  # raises an error if a figure of the table is missing
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
    """Whether values are SHA-256 hashes by name; names that are URLs must be below the folder of the file's URL."""
    folder = file.rpartition("/")[0]

    def is_below(url: str) -> bool:  # "::" would chain another URL
        return url.startswith(f"{folder}/") and "::" not in url[len(folder) :]

    return isinstance(values, dict) and all(
        isinstance(digest, str)
        and _SHA256.fullmatch(digest)
        and (not is_url(require_name(name)) or (is_url(file) and is_below(name)))
        for name, digest in values.items()
    )


def _is_number(value: object) -> bool:
    """Whether a value is a number within the range of floats."""
    return isinstance(value, float) or (type(value) is int and abs(value) < 1 << 63)
