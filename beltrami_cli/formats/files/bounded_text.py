"""Files in JSON and TOML that are not trusted: configurations, manifests, reports, records.

Their size, their nesting and the length of their lines are bounded, and texts with characters that cannot occur in file
names are refused. Every fault of such a file is a ValueError.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from beltrami_cli.formats.files.paths import open_regular

CONFIGURATION, MANIFEST, REPORT = 1 << 20, 1 << 24, 1 << 24  # bytes that such a file has at most
_MAX_NESTING = 50  # levels of tables and lists
_MAX_INTEGER = 1 << 64
# Characters of TOML, whose parser takes the square of the time for keys with very many dots.
_LONGEST_LINE = 1 << 13
_UNUSABLE = re.compile("[\0\ud800-\udc7f\udd00-\udfff]")  # the other surrogates stand for bytes of names


def read_bounded(path: Path, most: int) -> str:
    """Return the text of a regular file; OSError, or ValueError if it exceeds `most` bytes or is not UTF-8."""
    with open_regular(path) as file:
        return text_in(file, most)


def text_in(file: BinaryIO, most: int) -> str:
    """Return the text of an opened file; ValueError as `read_bounded`."""
    data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"it has more than {most} bytes")
    return data.decode("utf-8-sig")


def parse_json(text: str | bytes) -> Any:
    """Parse JSON; ValueError if it is damaged, nested too deeply, or holds unusable texts or numbers."""
    return _checked(lambda: json.loads(text))


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; ValueError as for `parse_json`."""
    import tomllib

    if any(len(line) > _LONGEST_LINE for line in text.splitlines()):
        raise ValueError(f"it has a line of more than {_LONGEST_LINE} characters")
    tree: dict[str, Any] = _checked(lambda: tomllib.loads(text))
    return tree


def require_text(text: str) -> str:
    """Return the text; ValueError if it has characters that cannot occur in file names."""
    unfit = _UNUSABLE.search(text)
    if unfit is not None:
        raise ValueError(f"it has the character U+{ord(unfit[0]):04X}, which no name can have")
    return text


def _checked(load: Callable[[], Any]) -> Any:
    too_deep = ValueError(f"it is nested more than {_MAX_NESTING} levels deep")
    try:
        tree = load()
    except RecursionError:
        raise too_deep from None
    level = [tree]
    for _ in range(_MAX_NESTING):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, str):
                require_text(value)
            elif isinstance(value, int) and abs(value) > _MAX_INTEGER:
                raise ValueError("it has a whole number of more than 64 bits")
            elif isinstance(value, dict):
                inner += [*value, *value.values()]
            elif isinstance(value, list):
                inner += value
        if not inner:
            return tree
        level = inner
    raise too_deep
