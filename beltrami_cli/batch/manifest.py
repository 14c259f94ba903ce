"""Lists of files with parameters for each, as TOML, CSV or JSON lines."""

from __future__ import annotations

import csv
import io
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

_WAY_OUT = "see beltrami batch --help for what a manifest looks like"


@dataclass(frozen=True)
class Row:
    """A file in a manifest.

    Attributes
    ----------
    input, output : str
        As they stand there; the output may be empty.
    options : mapping of str to object
        The rest, by name; what is empty is left out.
    origin : str
        The manifest and the line or entry, for messages.
    """

    input: str
    output: str
    options: Mapping[str, object]
    origin: str


def is_manifest(path: str) -> bool:
    """Tell by the extension whether a file is a manifest."""
    return Path(path).suffix.lower() in _READERS


def read_manifest(path: str) -> list[Row]:
    """Read a manifest.

    Parameters
    ----------
    path : str
        TOML with a table [[files]] for each file, and options for all above them; CSV with a line of names first; or
        JSON lines. Every file has an input, may have an output, and options by the names they have on the command line.

    Returns
    -------
    list of Row

    Raises
    ------
    InputError
        If it cannot be read, or a file has no input.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read ({error})", "check the path, and that it is UTF-8") from error
    try:
        found = list(_READERS[Path(path).suffix.lower()](text))
    except (ValueError, csv.Error, RecursionError) as error:
        raise InputError(path, f"the manifest cannot be read ({error})", _WAY_OUT) from error
    if not found:
        raise InputError(path, "the manifest names no files", _WAY_OUT)
    return [_row(entry, f"{path}, {where}") for where, entry in found]


def _row(entry: object, origin: str) -> Row:
    if not isinstance(entry, dict):
        raise InputError(origin, "there is no table of names and values", _WAY_OUT)
    options = {key: value for key, value in entry.items() if value not in ("", None)}
    source, target = options.pop("input", None), options.pop("output", "")
    if not isinstance(source, str) or not isinstance(target, str):
        raise InputError(origin, "it has no input, or one that is no text", _WAY_OUT)
    return Row(source, target, options, origin)


def _from_toml(text: str) -> Iterator[tuple[str, dict[str, Any]]]:
    tree = tomllib.loads(text)
    files = tree.pop("files", None)
    if not isinstance(files, list) or not all(isinstance(each, dict) for each in files):
        raise ValueError("there is no table [[files]]")
    for number, entry in enumerate(files, 1):
        yield f"file {number}", {**tree, **entry}


def _from_csv(text: str) -> Iterator[tuple[str, dict[str, Any]]]:
    table = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    if "input" not in (table.fieldnames or ()):
        raise ValueError("the first line has no column called input")
    for entry in table:
        if None in entry:
            raise ValueError(f"line {table.line_num} has more columns than the first")
        yield f"line {table.line_num}", entry


def _from_json_lines(text: str) -> Iterator[tuple[str, Any]]:
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip():
            yield f"line {number}", json.loads(line)


_READERS: dict[str, Callable[[str], Iterator[tuple[str, Any]]]] = {
    ".toml": _from_toml,
    ".csv": _from_csv,
    ".jsonl": _from_json_lines,
    ".ndjson": _from_json_lines,
}
