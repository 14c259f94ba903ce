"""Manifests: files with parameters for each.

TOML has a table [[files]] for each file, and options for all above them; CSV a line of names first; JSON lines an
object for each file. Every file has an input, may have an output, and options by their names on the command line.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.access import unreadable
from beltrami_cli.formats.files.bounded_text import (
    MANIFEST,
    parse_json,
    parse_toml,
    read_bounded,
    require_text,
)

_WAY_OUT = "see beltrami batch --help for what a manifest looks like"


class Entry(NamedTuple):
    """A file of a manifest."""

    origin: str  # the manifest and the line or entry, for messages
    source: str
    target: str  # may be empty
    options: dict[str, object]


def is_manifest(name: str) -> bool:
    return Path(name).suffix.lower() in _READERS


def read_manifest(path: str) -> list[Entry]:
    try:
        text = read_bounded(Path(path), MANIFEST)
    except (OSError, ValueError) as error:
        raise unreadable(path, error, "check that it is a file in UTF-8") from error
    try:
        tables = list(_READERS[Path(path).suffix.lower()](text))
    except (ValueError, csv.Error) as error:
        raise InputError(path, f"the manifest cannot be read ({error})", _WAY_OUT) from error
    if not tables:
        raise InputError(path, "the manifest names no files", _WAY_OUT)
    return [_entry(f"{path}, {where}", table) for where, table in tables]


def _entry(origin: str, table: object) -> Entry:
    if not isinstance(table, dict):
        raise InputError(origin, "there is no table of names and values", _WAY_OUT)
    options = {key: value for key, value in table.items() if value not in ("", None)}
    source, target = options.pop("input", None), options.pop("output", "")
    if not isinstance(source, str) or not isinstance(target, str):
        raise InputError(origin, "it has no input, or one that is not text", _WAY_OUT)
    return Entry(origin, source, target, options)


def _from_toml(text: str) -> Iterator[tuple[str, dict[str, Any]]]:
    tree = parse_toml(text)
    files = tree.pop("files", None)
    if not isinstance(files, list) or not all(isinstance(each, dict) for each in files):
        raise ValueError("there is no table [[files]]")
    for number, entry in enumerate(files, 1):
        yield f"file {number}", {**tree, **entry}


def _from_csv(text: str) -> Iterator[tuple[str, dict[str, Any]]]:
    table = csv.DictReader(io.StringIO(require_text(text), newline=""), strict=True)
    if "input" not in (table.fieldnames or ()):
        cause = "the first line has no column called input"
        raise ValueError(f"{cause}; points in .csv are named by a glob in quotes, or in a manifest")
    for entry in table:
        if None in entry:
            raise ValueError(f"line {table.line_num} has more columns than the first")
        yield f"line {table.line_num}", entry


def _from_json_lines(text: str) -> Iterator[tuple[str, Any]]:
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip():
            try:
                yield f"line {number}", parse_json(line)
            except ValueError as error:
                raise ValueError(f"line {number}: {error}") from error


_READERS: dict[str, Callable[[str], Iterator[tuple[str, Any]]]] = {
    ".toml": _from_toml,
    ".csv": _from_csv,
    ".jsonl": _from_json_lines,
    ".ndjson": _from_json_lines,
}
