"""The JSON text of a glTF file, and changes of it that keep its spelling.

Encoding the JSON again would change spacing, escapes and digits of numbers. So the text of the source is walked along
the new tree, and only members that differ are rewritten, in the style of the source.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.entries import Tree

_MAX_NESTING = 100  # levels of nesting; glTF needs about ten, and recursion must stay far from Python's limit
_DECODER = json.JSONDecoder()
_SURROGATE = re.compile("[\ud800-\udfff]")
_BLANKS = " \t\n\r"
_SPACE = re.compile(rf"[{_BLANKS}]*")
# Of a member: white space, and in objects the key and the colon.
_HEAD = re.compile(rf'([{_BLANKS}]*)(?:("[^"\\]*(?:\\.[^"\\]*)*")([{_BLANKS}]*:[{_BLANKS}]*))?')


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
    for _ in range(_MAX_NESTING):
        members = (each.values() if isinstance(each, dict) else each for each in level)
        level = [child for values in members for child in values if isinstance(child, dict | list)]
        if not level:
            return tree
    raise InputError(name, f"the JSON is nested more than {_MAX_NESTING} levels deep")


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
    start, end = _skip(text, 0), len(text.rstrip(_BLANKS))
    members, _ = _split(text[start:end])
    style = _Style(None, ":")
    if members:
        _, line, indent = members[0].lead.rpartition("\n")
        style = _Style(indent if line else None, members[0].colon.strip("\r\n") or ":")
    return text[:start] + style.revised(text[start:end], _DECODER.decode(text), tree, "") + text[end:]


@dataclass(frozen=True)
class _Member:
    """A member of an object or array, as it is written."""

    lead: str  # white space in front of it
    key: str  # with its quotes; "" in arrays
    colon: str  # with the white space around it
    text: str
    value: Any
    trail: str  # white space between it and a comma


def _skip(text: str, position: int) -> int:
    match = _SPACE.match(text, position)
    return match.end() if match else position


def _split(text: str) -> tuple[list[_Member], str]:
    """Return the members of an object or array, and what closes it."""
    members: list[_Member] = []
    at = 1
    while text[_skip(text, at)] not in "}]":
        head = _HEAD.match(text, at)
        assert head is not None  # all three parts may be empty
        lead, key, colon = head.groups("")
        value, end = _DECODER.raw_decode(text, head.end())
        comma = _skip(text, end)
        is_last = text[comma] != ","
        trail = "" if is_last else text[end:comma]
        members.append(_Member(lead, key, colon, text[head.end() : end], value, trail))
        if is_last:
            return members, text[end:]
        at = comma + 1
    return members, text[at:]


@dataclass(frozen=True)
class _Style:
    """How the source spaces its JSON."""

    indent: str | None  # characters of one level; None: one line
    colon: str

    def revised(self, text: str, old: object, new: Any, lead: str) -> str:
        """Return a value as text, with the unchanged parts as in the source; `lead` is as in `written`."""
        if old == new:
            return text
        if not (old and isinstance(old, dict | list) and type(old) is type(new)):
            return self.written(new, lead)
        members, close = _split(text)
        if isinstance(new, dict):
            kept = [(each, new[key]) for each in members if (key := json.loads(each.key)) in new]
            added = [(json.dumps(key, ensure_ascii=False), new[key]) for key in new if key not in old]
        else:
            kept = list(zip(members, new, strict=False))
            added = [("", value) for value in new[len(members) :]]
        pieces = [
            each.lead + each.key + each.colon + self.revised(each.text, each.value, value, each.lead)
            for each, value in kept
        ]
        lead = members[-1].lead
        pieces += [
            lead + key + (self.colon if key else "") + self.written(value, lead) for key, value in added
        ]
        # White space behind the last member is part of `close`.
        trails = [each.trail for each, _ in kept] + [""] * len(added)
        followed = [piece + trail for piece, trail in zip(pieces[:-1], trails[:-1], strict=True)]
        return text[0] + ",".join([*followed, *pieces[-1:]]) + close

    def written(self, value: object, lead: str) -> str:
        """Return a new value as text; `lead` is the white space in front of it or of its key."""
        separators = (",", self.colon) if "\n" in lead or self.colon == ":" else (", ", self.colon)
        indent = self.indent if "\n" in lead else None
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)
        if _SURROGATE.search(text):  # one half of a character, which UTF-8 cannot hold but an escape can
            text = json.dumps(value, allow_nan=False, indent=indent, separators=separators)
        return text.replace("\n", lead[: lead.rfind("\n") + 1].lstrip(" \t") + lead[lead.rfind("\n") + 1 :])
