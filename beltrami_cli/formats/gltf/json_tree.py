"""The JSON of a glTF file: objects that know their place, for errors, and text that is edited in place.

Readers check what they use through `Entry`, and `require_structure` what is only looked through. Encoding a tree anew
would change spacing, escapes and digits of numbers. So the text of the source is walked along the new tree, and only
members that differ are written anew, in the source's style.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

_EACH = "*"  # stands for all members of an object that are not named
_OBJECTS = {_EACH: dict[str, Any]()}
_INDICES = {_EACH: int}
_EXTENDED = {"extensions": _OBJECTS}
_PRIMITIVE = {
    "attributes": _INDICES,
    "targets": [_INDICES],
    "indices": int,
    "material": int,
    "extensions": {"KHR_draco_mesh_compression": {"attributes": _INDICES}, **_OBJECTS},
}
_SPARSE = {"indices": {"bufferView": int}, "values": {"bufferView": int}}
_SHAPE = {
    "extensionsUsed": [str],
    "extensionsRequired": [str],
    "accessors": [{"bufferView": int, "sparse": _SPARSE, **_EXTENDED}],
    "animations": [{"samplers": [{"input": int, "output": int}], **_EXTENDED}],
    "buffers": [_EXTENDED],
    "bufferViews": [_EXTENDED],
    "images": [{"bufferView": int, **_EXTENDED}],
    "materials": [_EXTENDED],
    "meshes": [{"primitives": [_PRIMITIVE], **_EXTENDED}],
    "nodes": [{"extensions": {"EXT_mesh_gpu_instancing": {"attributes": _INDICES}, **_OBJECTS}}],
    "skins": [{"inverseBindMatrices": int, **_EXTENDED}],
    "textures": [{"source": int, **_EXTENDED}],
    "extensions": {"EXT_lights_image_based": {"lights": [{}]}, **_OBJECTS},
}
_NAMES = {dict: "an object", list: "an array", int: "an integer", str: "a string"}


@dataclass(frozen=True)
class Entry:
    """One JSON object of a file."""

    name: str  # of the file, for messages
    place: str  # such as "meshes[3].primitives[0]"; empty for the outermost object
    value: Tree

    def __contains__(self, key: str) -> bool:
        return key in self.value

    def at(self, key: str) -> str:
        """Return the place of a member."""
        return f"{self.place}.{key}" if self.place else key

    def fault(self, key: str, cause: str, remedy: str = "") -> InputError:
        """Return the error that something is wrong with a member (or with the object, if `key` is empty)."""
        return InputError(self.name, f"{self.at(key) if key else self.place}: {cause}", remedy)

    def integer(
        self, key: str, *, least: int = 0, below: int | None = None, default: int | None = None
    ) -> int:
        """Return an integer member in [least, below)."""
        value = self.value.get(key, default)
        if value is None:
            raise self.fault(key, "is missing")
        return self._integer(value, key, least, below)

    def _integer(self, value: object, key: str, least: int, below: int | None) -> int:
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.fault(key, f"is {spelled(value)} instead of an integer")
        if value < least or (below is not None and value >= below):
            end = f" and below {below}" if below is not None else ""
            raise self.fault(key, f"is {spelled(value)}, but must be at least {least}{end}")
        return value

    def integers(self, key: str, *, below: int) -> list[int]:
        """Return an array of integers in [0, below); empty if it is missing."""
        values = enumerate(self._array(key))
        return [self._integer(value, f"{key}[{index}]", 0, below) for index, value in values]

    def numbers(self, key: str, length: int) -> list[float] | None:
        """Return an array of `length` finite numbers, or None if it is missing."""
        if key not in self.value:
            return None
        array = self._array(key)
        if len(array) != length or not all(_finite(value) for value in array):
            raise self.fault(key, f"must be {length} finite numbers")
        return [float(value) for value in array]

    def number(self, key: str, *, default: float) -> float:
        """Return a finite number."""
        value = self.value.get(key, default)
        if not _finite(value):
            raise self.fault(key, f"is {spelled(value)} instead of a finite number")
        return float(value)

    def flag(self, key: str) -> bool:
        """Return a boolean member; false if it is missing."""
        value = self.value.get(key, False)
        if not isinstance(value, bool):
            raise self.fault(key, f"is {spelled(value)} instead of true or false")
        return value

    def text(self, key: str) -> str | None:
        """Return a string member, or None if it is missing."""
        value = self.value.get(key)
        if value is not None and not isinstance(value, str):
            raise self.fault(key, f"is {spelled(value)} instead of a string")
        return value

    def texts(self, key: str) -> list[str]:
        """Return an array of strings; empty if it is missing."""
        array = self._array(key)
        if not all(isinstance(value, str) for value in array):
            raise self.fault(key, "must be an array of strings")
        return array

    def entry(self, key: str) -> Entry:
        """Return an object member; an empty one if it is missing."""
        value = self.value.get(key, {})
        if not isinstance(value, dict):
            raise self.fault(key, f"is {spelled(value)} instead of an object")
        return Entry(self.name, self.at(key), value)

    def entries(self, key: str) -> list[Entry]:
        """Return an array of objects; empty if it is missing."""
        found = []
        for index, value in enumerate(self._array(key)):
            if not isinstance(value, dict):
                raise self.fault(f"{key}[{index}]", f"is {spelled(value)} instead of an object")
            found.append(Entry(self.name, f"{self.at(key)}[{index}]", value))
        return found

    def _array(self, key: str) -> list[Any]:
        value = self.value.get(key, [])
        if not isinstance(value, list):
            raise self.fault(key, f"is {spelled(value)} instead of an array")
        return value


def _finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def spelled(value: object) -> str:
    """Return a value for a message: numbers and the like as they are, objects and arrays by their kind."""
    text = repr(value) if not isinstance(value, dict | list) else type(value).__name__
    return text if len(text) <= 40 else text[:37] + "..."


def require_structure(root: Entry) -> None:
    """Check the kinds of all members that are looked through without an `Entry`."""
    stack: list[tuple[str, Any, Any]] = [("", root.value, _SHAPE)]
    while stack:
        place, value, shape = stack.pop()
        kind: Any = shape if isinstance(shape, type) else type(shape)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise root.fault(place, f"is {spelled(value)} instead of {_NAMES[kind]}")
        if isinstance(shape, list):
            stack += [(f"{place}[{index}]", child, shape[0]) for index, child in enumerate(value)]
        elif isinstance(shape, dict):
            for key, child in value.items():
                if key in shape or _EACH in shape:
                    inner = shape.get(key, shape.get(_EACH))
                    stack.append((f"{place}.{key}" if place else key, child, inner))


def objects(values: object) -> list[Tree]:
    """Return the objects among the values of what should be an array of objects."""
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []


def primitives_of(tree: Tree) -> Iterator[tuple[tuple[int, int], Tree]]:
    """Give each primitive of all meshes, with the index of its mesh and its own in that."""
    for mesh, holder in enumerate(objects(tree.get("meshes"))):
        for part, primitive in enumerate(objects(holder.get("primitives"))):
            yield (mesh, part), primitive


Tree = dict[str, Any]

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
