"""The container of a glTF file, GLB chunks or plain JSON text: taken apart and put together again.

Encoding the JSON again would change spacing, escapes and digits of numbers. So the text of the source is walked along
the new tree, and only members that differ are rewritten, in the source's style.
"""

from __future__ import annotations

import json
import re
import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Bytes
from beltrami_cli.formats.gltf.json_tree import Entry, Tree, spelled

_MAGIC = b"glTF"
JSON_CHUNK = 0x4E4F534A
BIN_CHUNK = 0x004E4942

_BOM = b"\xef\xbb\xbf"
_TRUNCATED = "the file may be cut short: copy or export it again"
_DEEPEST = 100  # levels of nesting; glTF needs about ten, and recursion must stay far from Python's limit
_DECODER = json.JSONDecoder()
_SURROGATE = re.compile("[\ud800-\udfff]")
_SPACE = re.compile(r"[ \t\n\r]*")


@dataclass(frozen=True)
class Chunk:
    """One chunk of a GLB file: its type and its bytes without padding added by us."""

    kind: int
    data: Bytes


@dataclass(frozen=True)
class Container:
    """A glTF file taken apart."""

    name: str  # of the file, for messages
    kind: str  # "glb" or "gltf"
    data: bytes  # the whole file
    text: str  # the JSON, without byte order mark and without the padding of its chunk
    tree: Tree  # the JSON, parsed
    chunks: tuple[Chunk, ...] = ()  # those after the JSON chunk: BIN, then unknown ones
    has_bom: bool = False
    tail: Bytes = b""  # what follows the last byte that the GLB header counts

    @property
    def root(self) -> Entry:
        return Entry(self.name, "", self.tree)

    @property
    def binary(self) -> Bytes | None:
        """The BIN chunk, which must be the second; None without one."""
        return self.chunks[0].data if self.chunks and self.chunks[0].kind == BIN_CHUNK else None

    @property
    def unknown_chunks(self) -> tuple[Chunk, ...]:
        return self.chunks if self.binary is None else self.chunks[1:]

    def copy_of_tree(self) -> Tree:
        """Return a tree that may be changed and given to `rebuilt`."""
        return parsed(self.text, self.name)

    def rebuilt(self, tree: Tree, binary: Bytes | None) -> list[Bytes]:
        """Return the pieces of this file with another tree and BIN chunk (None: as it is), all else kept."""
        text = (("\ufeff" if self.has_bom else "") + revised(self.text, tree)).encode()
        if self.kind == "gltf":
            return [text]
        rest = self.chunks
        if binary is not None:
            rest = (Chunk(BIN_CHUNK, binary), *self.unknown_chunks)
        return [*glb_pieces([Chunk(JSON_CHUNK, text), *rest]), self.tail]


def read_container(data: bytes, name: str) -> Container:
    """Take a glTF file apart: binary if it starts with the GLB magic, otherwise JSON text."""
    container = _glb(data, name) if data[:4] == _MAGIC else _container("gltf", data, data, name)
    asset = container.root.entry("asset")
    stored = asset.value.get("version")
    # glTF 1 had it as a number, too.
    is_old = isinstance(stored, int | float) and stored < 2
    version = spelled(stored) if is_old else asset.text("version") or ""
    if version.split(".")[0] != "2":
        cause = f"is {spelled(stored)}" if version else "is missing"
        raise asset.fault("version", f"{cause}, but only glTF 2 can be read", "export the model as glTF 2.0")
    least = asset.text("minVersion")
    if least not in (None, "2.0"):
        raise asset.fault("minVersion", f"is {least!r}, but only glTF 2.0 can be read")
    return container


def _glb(data: bytes, name: str) -> Container:
    if len(data) < 20:
        raise InputError(name, f"a GLB file of {len(data)} bytes has no room for its header", _TRUNCATED)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        cause = f"GLB version {version} cannot be read, only 2"
        raise InputError(name, cause, "export the model as glTF 2.0")
    if length > len(data):
        raise InputError(name, f"the GLB header counts {length} bytes, the file has {len(data)}", _TRUNCATED)
    chunks: list[Chunk] = []
    position, view = 12, memoryview(data)
    while position < length:
        where = f"chunk {len(chunks)} at byte {position}"
        if position + 8 > length:
            raise InputError(name, f"{where}: its header is cut off", _TRUNCATED)
        size, kind = struct.unpack_from("<II", data, position)
        if position + 8 + size > length:
            raise InputError(name, f"{where}: {size} bytes do not fit in the file of {length}", _TRUNCATED)
        chunks.append(Chunk(kind, view[position + 8 : position + 8 + size]))
        position += 8 + size
    if not chunks or chunks[0].kind != JSON_CHUNK:
        raise InputError(name, "the first GLB chunk is not JSON", "export the model again")
    return _container("glb", bytes(chunks[0].data), data, name, tuple(chunks[1:]), view[length:])


def _container(
    kind: str, json: bytes, data: bytes, name: str, chunks: tuple[Chunk, ...] = (), tail: Bytes = b""
) -> Container:
    has_bom = json.startswith(_BOM)
    try:
        text = json.removeprefix(_BOM).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(name, f"neither GLB nor UTF-8 text (byte {error.start})", "is it glTF?") from None
    if kind == "glb":
        text = text.rstrip(" \0")
    return Container(name, kind, data, text, parsed(text, name), chunks, has_bom, tail)


def glb_pieces(chunks: Sequence[Chunk]) -> list[Bytes]:
    """Return a GLB file: header and chunks, JSON padded with spaces and the others with zeros to 4 bytes."""
    pieces: list[Bytes] = []
    for chunk in chunks:
        padding = (b" " if chunk.kind == JSON_CHUNK else b"\0") * (-len(chunk.data) % 4)
        pieces += [struct.pack("<II", len(chunk.data) + len(padding), chunk.kind), chunk.data, padding]
    return [_MAGIC + struct.pack("<II", 2, 12 + sum(len(piece) for piece in pieces)), *pieces]


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
    for _ in range(_DEEPEST):
        level = [child for parent in level for child in _children(parent)]
        if not level:
            return tree
    raise InputError(name, f"the JSON is nested more than {_DEEPEST} levels deep")


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
    if isinstance(span.value, dict | list) and type(span.value) is type(new) and span.value:
        return _members(span, new, text, style)
    return style.written(new, text[span.lead : span.key_start])


def _members(span: _Span, new: Any, text: str, style: _Style) -> str:
    """Return an object or array; what followed its last member in the source closes it."""
    old = _spans(text, span.start)
    if isinstance(new, dict):
        kept = [(member, new[member.key]) for member in old if member.key in new]
        names = {key: json.dumps(key, ensure_ascii=False) + style.colon for key in new}
        added = [(names[key], value) for key, value in new.items() if key not in span.value]
    else:
        kept = list(zip(old, new, strict=False))
        added = [("", value) for value in new[len(old) :]]
    lead = text[old[-1].lead : old[-1].key_start]
    pieces = [_piece(member, value, text, style) for member, value in kept]
    pieces += [(lead + name + style.written(value, lead), "") for name, value in added]
    joined = ",".join([*(one + trail for one, trail in pieces[:-1]), *(one for one, _ in pieces[-1:])])
    return text[span.start] + joined + text[old[-1].end : old[-1].trail + 1]


def _piece(span: _Span, new: object, text: str, style: _Style) -> tuple[str, str]:
    """Return a member or item with what precedes it, and the white space between it and its comma."""
    trail = text[span.end : span.trail] if text[span.trail] == "," else ""
    return text[span.lead : span.start] + _value(span, new, text, style), trail
