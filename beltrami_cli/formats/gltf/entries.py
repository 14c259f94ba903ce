"""The JSON objects of a glTF file, whose members are checked when they are read.

Readers check the members that they use through `Entry`, which knows its place for errors; `require_structure` checks
the others.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any, TypeVar

from beltrami_cli.errors import InputError

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
        members = []
        for index, value in enumerate(self._of_kind(key, list[Any]())):
            if not isinstance(value, dict):
                raise self.fault(f"{key}[{index}]", f"is {spelled(value)} instead of an object")
            members.append(Entry(self.name, f"{self.at(key)}[{index}]", value))
        return members

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
