"""Objects of the glTF JSON that know their place, so that every complaint can name it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.json_text import Tree


@dataclass(frozen=True)
class Entry:
    """One JSON object.

    Attributes
    ----------
    name : str
        The file, for messages.
    place : str
        Where the object stands ("meshes[3].primitives[0]"); empty for the outermost.
    value : dict
        Its members.
    """

    name: str
    place: str
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
        """Return an integer member in [least, below).

        Raises
        ------
        InputError
            If it is missing without a default, not an integer, or out of range.
        """
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
        return [
            self._integer(value, f"{key}[{index}]", 0, below) for index, value in enumerate(self._array(key))
        ]

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
