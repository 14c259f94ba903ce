"""The text of the JSON of a glTF file: read strictly, and edited in place.

Encoding a tree anew would change spacing, escapes and digits of numbers. So the text of the source is walked along the
new tree, and only members that differ are written anew, in the source's style.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.json_tree import Tree

DEEPEST = 100
"""Levels of nesting that are read; glTF needs about ten, and recursion must stay far from Python's limit."""

_DECODER = json.JSONDecoder()
_SURROGATE = re.compile("[\ud800-\udfff]")
_SPACE = re.compile(r"[ \t\n\r]*")


def parsed(text: str, name: str) -> Tree:
    """Read strict JSON whose outermost value is an object; no repeated keys, NaN, Infinity or absurd nesting."""
    try:
        tree = json.loads(text, object_pairs_hook=_unique, parse_constant=_refused)
    except RecursionError:
        raise InputError(name, "the JSON is nested too deeply") from None
    except ValueError as error:
        raise InputError(name, f"the JSON is damaged: {error}", "export the model again") from None
    if not isinstance(tree, dict):
        raise InputError(name, "the JSON is not an object, so this is not glTF")
    level: list[Any] = [tree]
    for _ in range(DEEPEST):
        level = [child for parent in level for child in _children(parent)]
        if not level:
            return tree
    raise InputError(name, f"the JSON is nested more than {DEEPEST} levels deep")


def _children(parent: object) -> list[Any]:
    values = parent.values() if isinstance(parent, dict) else parent if isinstance(parent, list) else ()
    return [value for value in values if isinstance(value, dict | list)]


def _unique(pairs: list[tuple[str, Any]]) -> Tree:
    tree = dict(pairs)
    if len(tree) < len(pairs):
        repeated = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the key {repeated!r} occurs twice in one object")
    return tree


def _refused(constant: str) -> None:
    raise ValueError(f"{constant} is not a JSON number")


def revised(text: str, tree: Tree) -> str:
    """Write a changed tree; members that equal those parsed from `text` keep their characters in it."""
    start = _skip(text, 0)
    old, end = _DECODER.raw_decode(text, start)
    return text[:start] + _value(_Span(start, end, old), tree, text, _style(text, start)) + text[end:]


@dataclass(frozen=True)
class _Span:
    """A value of the source and where it stands."""

    start: int
    end: int
    value: Any
    key: str = ""
    lead: int = 0  # after the comma or bracket before the value, and before its key
    key_start: int = 0
    key_end: int = 0
    trail: int = 0  # the comma or bracket after the value


@dataclass(frozen=True)
class _Style:
    """How the source spaces its JSON."""

    indent: str | None  # characters of one level; None: one line
    colon: str

    def written(self, value: object, lead: str) -> str:
        """Return a new value as text; `lead` is the white space in front of it or of its key."""
        separators = (",", self.colon) if "\n" in lead or self.colon == ":" else (", ", self.colon)
        indent = self.indent if "\n" in lead else None
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)
        if _SURROGATE.search(text):  # one half of a character, which UTF-8 cannot hold but an escape can
            text = json.dumps(value, allow_nan=False, indent=indent, separators=separators)
        return text.replace("\n", lead[: lead.rfind("\n") + 1].lstrip(" \t") + lead[lead.rfind("\n") + 1 :])


def _style(text: str, start: int) -> _Style:
    members = _spans(text, start)
    if not members:
        return _Style(None, ":")
    lead = text[members[0].lead : members[0].key_start]
    indent = lead[lead.rfind("\n") + 1 :] if "\n" in lead else None
    return _Style(indent, text[members[0].key_end : members[0].start].strip("\r\n") or ":")


def _skip(text: str, position: int) -> int:
    match = _SPACE.match(text, position)
    return match.end() if match else position


def _spans(text: str, start: int) -> list[_Span]:
    """Return the members of the object or array at `start`."""
    spans: list[_Span] = []
    keyed = text[start] == "{"
    lead = start + 1
    while text[position := _skip(text, lead)] not in "}]":
        key, key_start, key_end = "", position, position
        if keyed:
            key, key_end = _DECODER.raw_decode(text, position)
            position = _skip(text, _skip(text, key_end) + 1)
        value, end = _DECODER.raw_decode(text, position)
        comma = _skip(text, end)
        spans.append(_Span(position, end, value, key, lead, key_start, key_end, comma))
        if text[comma] != ",":
            break
        lead = comma + 1
    return spans


def _value(span: _Span, new: object, text: str, style: _Style) -> str:
    if span.value == new:
        return text[span.start : span.end]
    if isinstance(span.value, dict) and isinstance(new, dict) and span.value:
        return _object(span, new, text, style)
    if isinstance(span.value, list) and isinstance(new, list) and span.value:
        return _array(span, new, text, style)
    return style.written(new, text[span.lead : span.key_start])


def _object(span: _Span, new: Tree, text: str, style: _Style) -> str:
    members = _spans(text, span.start)
    kept = [member for member in members if member.key in new]
    pieces = [_piece(member, new[member.key], text, style) for member in kept]
    lead = text[members[-1].lead : members[-1].key_start]
    for key, value in new.items():
        if key not in span.value:
            name = json.dumps(key, ensure_ascii=False)
            pieces.append((lead + name + style.colon + style.written(value, lead), ""))
    return "{" + _joined(pieces, text[members[-1].end : members[-1].trail]) + "}"


def _array(span: _Span, new: list[Any], text: str, style: _Style) -> str:
    items = _spans(text, span.start)
    pieces = [_piece(item, value, text, style) for item, value in zip(items, new, strict=False)]
    lead = text[items[-1].lead : items[-1].start]
    pieces += [(lead + style.written(value, lead), "") for value in new[len(items) :]]
    return "[" + _joined(pieces, text[items[-1].end : items[-1].trail]) + "]"


def _piece(span: _Span, new: object, text: str, style: _Style) -> tuple[str, str]:
    """Return a member or item with what precedes it, and the white space between it and its comma."""
    trail = text[span.end : span.trail] if text[span.trail] == "," else ""
    return text[span.lead : span.start] + _value(span, new, text, style), trail


def _joined(pieces: list[tuple[str, str]], close: str) -> str:
    """Join pieces with commas; what followed the last one of the source closes the result."""
    return ",".join([*(one + trail for one, trail in pieces[:-1]), *(one for one, _ in pieces[-1:])]) + close
