"""The body of a PLY file, binary or text, as values that stand at units.

Both kinds are read in one way, by counting in units: bytes of a binary body, tokens of a text. A scalar takes
as many units as its type has bytes (one unit, in a text), and what stands at a unit is a look into an array
that has a value at every unit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.tokens import read_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.ply.header import Header


class Body(Protocol):
    """The units behind the header."""

    name: str
    start: int
    stop: int

    def size(self, kind: str) -> int:
        """Return how many units a scalar takes."""

    def view(self, kind: str) -> NDArray[Any]:
        """Return an array that has at every unit the value which would start there."""

    def checked(self, values: NDArray[Any], kind: str, where: str) -> NDArray[Any]:
        """Return values from `view` in their type; InputError if they cannot be of it."""


def values_in_bytes(data: bytes | bytearray, kind: str) -> NDArray[Any]:
    """Return the overlapping values that start at every byte; writable if the data are."""
    size = np.dtype(kind).itemsize
    return np.ndarray((max(len(data) - size + 1, 0),), kind, data, strides=(1,))


class BinaryBody:
    """A body of bytes; places are offsets in the file."""

    def __init__(self, data: bytes, header: Header, name: str) -> None:
        self.name = name
        self.start, self.stop = header.end, len(data)
        self._data, self._order = data, header.order

    def size(self, kind: str) -> int:
        """Return how many units a scalar takes."""
        return np.dtype(kind).itemsize

    def view(self, kind: str) -> NDArray[Any]:
        """Return the value that starts at every unit."""
        return values_in_bytes(self._data, self._order + kind)

    def checked(self, values: NDArray[Any], kind: str, where: str) -> NDArray[Any]:
        """Return values in their type."""
        return values.astype(kind)


class TextBody:
    """A body of text; places are numbers of tokens."""

    def __init__(self, data: bytes, header: Header, name: str) -> None:
        self.name = name
        self._values = read_numbers(data[header.end :])
        self.start, self.stop = 0, len(self._values)

    def size(self, kind: str) -> int:
        """Return how many units a scalar takes."""
        return 1

    def view(self, kind: str) -> NDArray[Any]:
        """Return the value that starts at every unit."""
        return self._values

    def checked(self, values: NDArray[Any], kind: str, where: str) -> NDArray[Any]:
        """Return values in their type; InputError if one cannot be of it."""
        if kind[0] == "f":
            return values
        limits = np.iinfo(kind)
        fits = (values == np.rint(values)) & (values >= limits.min) & (values <= limits.max)
        if not fits.all():
            row = int(np.argmin(fits))
            raise InputError(self.name, f"{where}: {values[row]:g} in row {row} is no {np.dtype(kind)}")
        return values.astype(kind)
