"""The record of a batch: its report as JSON lines, from which a later run resumes."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.batch.item import Outcome
from beltrami_cli.batch.storage import exists, hash_at, is_url, place_of
from beltrami_cli.errors import InputError, OutputError
from beltrami_cli.formats.document import Written
from beltrami_cli.jobs.writing.output import Output, Overwrite

if TYPE_CHECKING:
    from collections.abc import Iterable

    from beltrami_cli.batch.item import Item

_HEAD = re.compile(rb'\{"input": ".*", "output": ".*", "status": "')
_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{12}\.tmp")  # as `replacing.temporary_beside` names them


class Record:
    """A report as it grows: a line when a file is started, and one when it is finished.

    `resume`: go on from what is there; InputError if that cannot be read.
    `overwrite`: replace it, or only another record ("own").
    """

    def __init__(self, path: str, *, resume: bool, overwrite: Overwrite) -> None:
        self.path = path
        if not resume and not overwrite and Path(path).exists():
            raise OutputError(path, "exists already", "--resume goes on from it, --overwrite starts anew")
        self._output = Output(path, overwrite=resume or overwrite, what="report", is_own=_is_record)
        self._latest = _read(path) if resume and Path(path).exists() else {}
        self.close([])  # without the line that the end of a run cut off
        self._output.overwrite = True  # from now on it is ours

    def latest(self, item: Item) -> Outcome | None:
        """Return the last line of an item's output."""
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
        """Write the report anew, with one line a file: those of this run in their order, after the others."""
        now = {place_of(outcome.output): outcome for outcome in outcomes}
        earlier = {place: outcome for place, outcome in self._latest.items() if place not in now}
        self._output.write(
            Written(main=[_line(each).encode() for each in [*earlier.values(), *now.values()]])
        )


def is_done(item: Item, outcome: Outcome | None) -> bool:
    """Return whether an earlier run did the item, and nothing that it depends on has changed since."""
    if outcome is None or outcome.status not in ("done", "skipped"):
        return False
    same = outcome.parameters_sha256 == item.parameters and place_of(item.source) == place_of(outcome.input)
    return same and _holds(outcome.read) and _holds(outcome.written)


def is_ours(outcome: Outcome | None) -> bool:
    """Return whether the files at the place of an output are as an earlier run left them, and may be replaced."""
    if outcome is None:
        return False
    if outcome.status == "started":  # it looked that there were none
        return True
    return place_of(outcome.output) in outcome.written and all(
        not exists(name) or _holds({name: digest}) for name, digest in outcome.written.items()
    )


def remove_leftovers(outcome: Outcome | None) -> None:
    """Remove what a run that was killed left half written beside its output."""
    if outcome is None or outcome.status != "started" or is_url(outcome.output):
        return
    folder = Path(place_of(outcome.output)).parent
    for path in folder.glob(".*.tmp"):
        if _TEMPORARY.fullmatch(path.name) and path.stat().st_mtime >= outcome.time - 1:
            path.unlink(missing_ok=True)


def _is_record(head: bytes) -> bool:
    return _HEAD.match(head) is not None


def _holds(hashes: dict[str, str]) -> bool:
    try:
        return all(hash_at(name) == digest for name, digest in hashes.items())
    except OSError:
        return False


def _line(outcome: Outcome) -> str:
    return json.dumps(dataclasses.asdict(outcome)) + "\n"


def _read(path: str) -> dict[str, Outcome]:
    """Return the last line of each output; the very last line may be cut off by the end of a run."""
    latest: dict[str, Outcome] = {}
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read ({error})", "leave out --resume") from error
    for number, line in enumerate(lines, 1):
        try:
            outcome = Outcome(**json.loads(line))
        except (ValueError, TypeError):
            if number == len(lines) and not line.endswith("\n"):
                break
            cause = f"line {number} is not of a report of beltrami batch"
            raise InputError(path, cause, "leave out --resume, or choose another --report") from None
        latest.pop(place_of(outcome.output), None)
        latest[place_of(outcome.output)] = outcome
    return latest
