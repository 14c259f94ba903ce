"""A glTF file as JSON and binary chunks: GLB or plain text, taken apart and put together again.

Readers check the members of the JSON that they use through `Entry`, which knows its place for errors;
`require_structure` checks the others. Encoding the JSON again would change spacing, escapes and digits of numbers. So
the text of the source is walked along the new tree, and only members that differ are rewritten, in the source's style.
"""

from __future__ import annotations

import json
import re
import struct
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes

Tree = dict[str, Any]
T = TypeVar("T")

_ANY_MEMBER = "*"  # stands for all members of an object that are not named
_OBJECTS = {_ANY_MEMBER: dict[str, Any]()}
_INDICES = {_ANY_MEMBER: int}
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
_NAMES = {dict: "an object", list: "an array", int: "an integer", str: "a string", bool: "true or false"}

_MAGIC = b"glTF"
JSON_CHUNK = 0x4E4F534A
BIN_CHUNK = 0x004E4942

_BOM = "\ufeff"
TRUNCATED = "the file may be cut short: copy or export it again"
_MAX_NESTING = 100  # levels of nesting; glTF needs about ten, and recursion must stay far from Python's limit
_DECODER = json.JSONDecoder()
_SURROGATE = re.compile("[\ud800-\udfff]")
_BLANKS = " \t\n\r"
_SPACE = re.compile(rf"[{_BLANKS}]*")
_HEAD = re.compile(
    rf'([{_BLANKS}]*)(?:("[^"\\]*(?:\\.[^"\\]*)*")([{_BLANKS}]*:[{_BLANKS}]*))?'
)  # of a member


@dataclass(frozen=True)
class Entry:
    """One JSON object of a file; members that are missing give None, an empty array or object, or false."""

    name: str  # of the file, for messages
    place: str  # such as "meshes[3].primitives[0]"; empty for the outermost object
    value: Tree

    def __contains__(self, key: str) -> bool:
        return key in self.value

    def at(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def fault(self, key: str, cause: str, remedy: str = "") -> InputError:
        """Return the error that something is wrong with a member (or with the object, if `key` is empty)."""
        return InputError(self.name, f"{self.at(key) if key else self.place}: {cause}", remedy)

    def integer(
        self, key: str, *, least: int = 0, below: int | None = None, default: int | None = None
    ) -> int:
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
        values = enumerate(self._of_kind(key, list[Any]()))
        return [self._integer(value, f"{key}[{index}]", 0, below) for index, value in values]

    def numbers(self, key: str, length: int) -> list[float] | None:
        if key not in self.value:
            return None
        array = self._of_kind(key, list[Any]())
        if len(array) != length or not all(_is_finite(value) for value in array):
            raise self.fault(key, f"must be {length} finite numbers")
        return [float(value) for value in array]

    def number(self, key: str, *, default: float) -> float:
        value = self.value.get(key, default)
        if not _is_finite(value):
            raise self.fault(key, f"is {spelled(value)} instead of a finite number")
        return float(value)

    def flag(self, key: str) -> bool:
        return self._of_kind(key, False)

    def text(self, key: str) -> str | None:
        return None if self.value.get(key) is None else self._of_kind(key, "")

    def entry(self, key: str) -> Entry:
        return Entry(self.name, self.at(key), self._of_kind(key, Tree()))

    def entries(self, key: str) -> list[Entry]:
        found = []
        for index, value in enumerate(self._of_kind(key, list[Any]())):
            if not isinstance(value, dict):
                raise self.fault(f"{key}[{index}]", f"is {spelled(value)} instead of an object")
            found.append(Entry(self.name, f"{self.at(key)}[{index}]", value))
        return found

    def _of_kind(self, key: str, default: T) -> T:
        value = self.value.get(key, default)
        if not isinstance(value, type(default)):
            raise self.fault(key, f"is {spelled(value)} instead of {_NAMES[type(default)]}")
        return value


def _is_finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max


def spelled(value: object) -> str:
    """Spell a value for a message: objects and arrays by their kind."""
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
                if key in shape or _ANY_MEMBER in shape:
                    inner = shape.get(key, shape.get(_ANY_MEMBER))
                    stack.append((f"{place}.{key}" if place else key, child, inner))


def objects_within(value: object) -> Iterator[Tree]:
    """Yield all objects in a value, itself included."""
    stack = [value]
    while stack:
        value = stack.pop()
        if isinstance(value, list):
            stack += value
        elif isinstance(value, dict):
            stack += value.values()
            yield value


def objects(values: object) -> list[Tree]:
    """Return the objects among the values of an array that should hold nothing else."""
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []


def primitives_of(tree: Tree) -> Iterator[tuple[tuple[int, int], Tree]]:
    """Yield the primitives of all meshes, each with the index of its mesh and its own within the mesh."""
    for mesh, holder in enumerate(objects(tree.get("meshes"))):
        for part, primitive in enumerate(objects(holder.get("primitives"))):
            yield (mesh, part), primitive


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
    chunks: tuple[Chunk, ...] = ()  # after the JSON chunk: BIN, then unknown ones
    has_bom: bool = False
    tail: Bytes = b""  # bytes behind the length that the GLB header states

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
        """Return the pieces of this file with another tree and BIN chunk (None: unchanged), all else kept."""
        text = ((_BOM if self.has_bom else "") + revised(self.text, tree)).encode()
        if self.kind == "gltf":
            return [text]
        rest = self.chunks if binary is None else (Chunk(BIN_CHUNK, binary), *self.unknown_chunks)
        return [*glb_pieces([Chunk(JSON_CHUNK, text), *rest]), self.tail]


def read_container(data: bytes, name: str) -> Container:
    """Take a glTF file apart: binary if it starts with the GLB magic, otherwise JSON text."""
    is_glb = data[:4] == _MAGIC
    chunks, tail = _glb_chunks(data, name) if is_glb else ([Chunk(JSON_CHUNK, data)], b"")
    try:
        text = bytes(chunks[0].data).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(name, f"neither GLB nor UTF-8 text (byte {error.start})", "is it glTF?") from None
    has_bom, text = text.startswith(_BOM), text.removeprefix(_BOM)
    if is_glb:
        text = text.rstrip(" \0")
    kind, tree = "glb" if is_glb else "gltf", parsed(text, name)
    container = Container(name, kind, data, text, tree, tuple(chunks[1:]), has_bom, tail)
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


def _glb_chunks(data: bytes, name: str) -> tuple[list[Chunk], Bytes]:
    """Return the chunks of a GLB file, the first being JSON, and the bytes behind its stated length."""
    if len(data) < 20:
        raise InputError(name, f"a GLB file of {len(data)} bytes has no room for its header", TRUNCATED)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        cause = f"GLB version {version} cannot be read, only 2"
        raise InputError(name, cause, "export the model as glTF 2.0")
    if length > len(data):
        raise InputError(name, f"the GLB header counts {length} bytes, the file has {len(data)}", TRUNCATED)
    chunks: list[Chunk] = []
    position, view = 12, memoryview(data)
    while position < length:
        where = f"chunk {len(chunks)} at byte {position}"
        if position + 8 > length:
            raise InputError(name, f"{where}: its header is cut off", TRUNCATED)
        size, kind = struct.unpack_from("<II", data, position)
        if position + 8 + size > length:
            raise InputError(name, f"{where}: {size} bytes do not fit in the file of {length}", TRUNCATED)
        chunks.append(Chunk(kind, view[position + 8 : position + 8 + size]))
        position += 8 + size
    if not chunks or chunks[0].kind != JSON_CHUNK:
        raise InputError(name, "the first GLB chunk is not JSON", "export the model again")
    return chunks, view[length:]


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
            (
                each.lead + each.key + each.colon + self.revised(each.text, each.value, value, each.lead),
                each.trail,
            )
            for each, value in kept
        ]
        lead = members[-1].lead
        pieces += [
            (lead + key + (self.colon if key else "") + self.written(value, lead), "") for key, value in added
        ]
        joined = ",".join([*(one + trail for one, trail in pieces[:-1]), *(one for one, _ in pieces[-1:])])
        return text[0] + joined + close

    def written(self, value: object, lead: str) -> str:
        """Return a new value as text; `lead` is the white space in front of it or of its key."""
        separators = (",", self.colon) if "\n" in lead or self.colon == ":" else (", ", self.colon)
        indent = self.indent if "\n" in lead else None
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)
        if _SURROGATE.search(text):  # one half of a character, which UTF-8 cannot hold but an escape can
            text = json.dumps(value, allow_nan=False, indent=indent, separators=separators)
        return text.replace("\n", lead[: lead.rfind("\n") + 1].lstrip(" \t") + lead[lead.rfind("\n") + 1 :])
