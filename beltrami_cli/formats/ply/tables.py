"""The elements of a PLY file as tables, with the offset of each value in the body.

Binary bodies and text are read in one way, by counting in units: bytes of a binary body, tokens of a text. A scalar
takes as many units as its type has bytes (one unit, in a text), and what stands at a unit is a look into an array that
has a value at every unit.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import takewhile
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.files import edits
from beltrami_cli.formats.files.tokens import find_tokens, read_numbers
from beltrami_cli.formats.ply.header import Element, Header, Property
from beltrami_cli.surface.precision import require_finite


def values_in_bytes(data: bytes | bytearray, kind: str) -> Array:
    """Return the overlapping values that start at every byte; writable if the data are."""
    size = np.dtype(kind).itemsize
    return np.ndarray((max(len(data) - size + 1, 0),), kind, data, strides=(1,))


Places = slice | np.ndarray[Any, np.dtype[np.int64]]


def indices(places: Places) -> Int64s:
    """Return places as an array."""
    return np.arange(places.start, places.stop, places.step) if isinstance(places, slice) else places


@dataclass(frozen=True)
class NewValues:
    """New values of one scalar property."""

    places: Places  # in all rows
    rows: Bools  # which rows change
    values: Array  # their new values, in the property's type


class Body:
    """A binary body; units are bytes, counted from the start of the file."""

    def __init__(self, data: bytes, header: Header, name: str) -> None:
        self.name = name
        self.start, self.stop = header.end, len(data)
        self._data, self.order = data, header.order

    def size(self, kind: str) -> int:
        """Return how many units a scalar takes."""
        return np.dtype(kind).itemsize

    def view(self, kind: str) -> Array:
        """Return an array that has at every unit the value which would start there."""
        return values_in_bytes(self._data, self.order + kind)

    def checked(self, values: Array, kind: str, where: str) -> Array:
        """Return values from `view` in their type; InputError if they cannot be of it."""
        return values.astype(kind)

    def patched(self, changes: Sequence[NewValues]) -> list[Bytes]:
        """Return the body in pieces with new values (at least one, each property once); other bytes stay."""
        patched = bytearray(self._data)
        for change in changes:
            view, places = values_in_bytes(patched, self.order + change.values.dtype.str[1:]), change.places
            if isinstance(places, slice):
                view[places][change.rows] = change.values
            else:
                view[places[change.rows]] = change.values
        return [memoryview(patched)[self.start :]]

    def without(self, units: Int64s, kind: str) -> bytes:
        """Return the body without the scalars of one type at some units."""
        return edits.zeroed(self._data, units, self.size(kind))[self.start :]


class TextBody(Body):
    """A body of text; units are tokens."""

    def __init__(self, data: bytes, header: Header, name: str) -> None:
        super().__init__(data, header, name)
        self._first = header.end
        self._values = read_numbers(self._text)
        self.start, self.stop = 0, len(self._values)

    @property
    def _text(self) -> bytes:
        return self._data[self._first :]  # not kept, as it may be large

    def size(self, kind: str) -> int:
        return 1

    def view(self, kind: str) -> Array:
        return self._values

    def checked(self, values: Array, kind: str, where: str) -> Array:
        if kind[0] == "f":
            return values
        limits = np.iinfo(kind)
        fits = (values == np.rint(values)) & (values >= limits.min) & (values <= limits.max)
        if not fits.all():
            row = int(np.argmin(fits))
            raise InputError(
                self.name, f"{where}: {values[row]:g} in row {row} is not of type {np.dtype(kind)}"
            )
        return values.astype(kind)

    def patched(self, changes: Sequence[NewValues]) -> list[Bytes]:
        text, new = self._text, list[edits.NewNumbers]()
        starts, ends = find_tokens(text)
        for change in changes:
            tokens = indices(change.places)[change.rows]
            new.append(edits.NewNumbers(starts[tokens], ends[tokens], change.values))
        return [*edits.renumbered(text, new)]

    def without(self, units: Int64s, kind: str) -> bytes:
        text, tokens = self._text, np.sort(units)
        starts, ends = find_tokens(text)
        return edits.without_tokens(text, starts[tokens], ends[tokens])


# Red, green and blue, then opacity, from the highest byte but one down and the highest, as PCL packs them.
_PACKED = ("rgb", "rgba")
_PACKED_ORDER = {"<": (2, 1, 0, 3), ">": (3, 0, 1, 2)}
COLOUR_PROPERTIES = ("color", "colors", "colour", "colours", *_PACKED)


def plain(name: str) -> str:
    """Return the name of a property without capitals and the prefix that CloudCompare gives it."""
    return name.lower().removeprefix("scalar_")


@dataclass(frozen=True)
class Table:
    """The rows of one element."""

    body: Body
    element: Element
    start: int  # unit of the first row
    # (N, L): lengths of the L lists of every row; a broadcast view if all rows are equal, one row if L is 0.
    counts: Int64s

    @cached_property
    def _lists(self) -> list[Property]:
        return self.element.lists

    @cached_property
    def _has_equal_rows(self) -> bool:
        return not self._lists or self.counts.strides[0] == 0

    @cached_property
    def _row_size(self) -> Int64s:
        """Units of every row, or of any row if all are equal: shape (N,) or (1,)."""
        items = np.array([self.body.size(prop.type) for prop in self._lists], np.int64)
        counts = self.counts[:1] if self._has_equal_rows else self.counts
        return counts @ items + sum(self.body.size(p.count or p.type) for p in self.element.properties)

    @property
    def stop(self) -> int:
        if self.element.count == 0:
            return self.start
        if self._has_equal_rows:
            return self.start + self.element.count * int(self._row_size[0])
        return self.start + int(self._row_size.sum())

    def places(self, name: str) -> Places:
        """Return the units of a scalar, or of the counts of a list: a slice if all rows are equal."""
        row_size = self._row_size
        if self._has_equal_rows:
            first = self.start + int(self._offset(name, self.counts[:1])[0])
            step = int(row_size[0])
            return slice(first, first + step * (self.element.count - 1) + 1, step)
        rows = self.start + np.cumsum(row_size) - row_size
        return np.asarray(rows + self._offset(name, self.counts))

    def _offset(self, name: str, counts: Int64s) -> Int64s:
        """Units between the start of a row and a property of it, shape (rows of counts,)."""
        offset, lists = np.zeros(len(counts), np.int64), 0
        for prop in takewhile(lambda prop: prop.name != name, self.element.properties):
            offset += self.body.size(prop.count or prop.type)
            if prop.count:
                offset += counts[:, lists] * self.body.size(prop.type)
                lists += 1
        return offset

    def scalars(self, name: str) -> Array:
        """Return a scalar property of all rows, shape (N,), in its type (float64 for floats in text)."""
        kind = self.element.scalars[name]
        if self.element.count == 0:
            return np.empty(0, kind)
        values = self.body.view(kind)[self.places(name)]
        return self.body.checked(values, kind, f"property '{name}' of element '{self.element.name}'")

    def columns(self, names: Sequence[str], what: str) -> Float64s:
        """Return some scalars of all rows, shape (N, len(names)); InputError if one is not finite."""
        values = np.empty((self.element.count, len(names)))
        with np.errstate(invalid="ignore"):  # Signalling NaNs warn when they are made wider.
            for column, name in enumerate(names):
                values[:, column] = self.scalars(name)
        require_finite(values, self.body.name, f"the {what} of {self.element.name}")
        return values

    def lists(self, name: str) -> tuple[Array, Int64s]:
        """Return the items of a list property, rows one after the other, and its N + 1 offsets therein."""
        prop = next(prop for prop in self._lists if prop.name == name)
        lengths = self.counts[:, self._lists.index(prop)]
        offsets = np.append(0, np.cumsum(lengths))
        if offsets[-1] == 0:
            return np.empty(0, prop.type), offsets
        size = self.body.size(prop.type)
        firsts = indices(self.places(name)) + self.body.size(prop.count) - size * offsets[:-1]
        units = np.repeat(firsts, lengths) + size * np.arange(offsets[-1])
        where = f"list '{name}' of element '{self.element.name}'"
        return self.body.checked(self.body.view(prop.type)[units], prop.type, where), offsets


def _with_channels(table: Table) -> Table:
    """Name the channels of colours that are lists of one length, or packed into a number, as scalars of their own.

    Their layout in the file is the same. A channel of the property p is "p 0", which no property can be called.
    """
    properties: list[Property] = []
    body, kept, lists = table.body, list[int](), 0
    for prop in table.element.properties:
        word, channels = plain(prop.name), list[Property]()
        if prop.count:
            lengths = table.counts[:, lists]
            if word in COLOUR_PROPERTIES and 1 <= lengths.min() == lengths.max() <= 4:
                channels = [Property(f"{prop.name} count", prop.count)]
                channels += [Property(f"{prop.name} {n}", prop.type) for n in range(int(lengths[0]))]
            else:
                kept.append(lists)
            lists += 1
        elif word in _PACKED and np.dtype(prop.type).itemsize == 4 and body.order:
            channels = [Property(f"{prop.name} {n}", "u1") for n in _PACKED_ORDER[body.order]]
        properties += channels or [prop]
    element = replace(table.element, properties=tuple(properties))
    return Table(body, element, table.start, table.counts if len(kept) == lists else table.counts[:, kept])


def read_body(data: bytes, header: Header, name: str) -> Body:
    return Body(data, header, name) if header.order else TextBody(data, header, name)


def read_tables(body: Body, header: Header) -> dict[str, Table]:
    """Find the rows of all elements; InputError if the file ends before its last row, or a list is damaged."""
    tables: dict[str, Table] = {}
    at = body.start
    for element in header.elements:
        table = Table(body, element, at, _list_lengths(body, element, at))
        at = table.stop
        tables[element.name] = _with_channels(table) if element.count else table
    return tables


def _list_lengths(body: Body, element: Element, start: int) -> Int64s:
    """Return the lengths of the L lists of every row, shape (N, L), checking that the body has the rows."""
    lists = len(element.lists)
    least = sum(body.size(prop.count or prop.type) for prop in element.properties)
    if least * element.count > body.stop - start:
        raise _cut_off(body, element)
    if lists == 0 or element.count == 0:
        return np.empty((0 if lists else 1, lists), np.int64)
    first = _walk(body, element, start, 1)
    uniform = Table(body, element, start, np.broadcast_to(first, (element.count, lists)))
    if uniform.stop <= body.stop and all(
        (body.view(prop.count)[uniform.places(prop.name)] == first[0, number]).all()
        for number, prop in enumerate(element.lists)
    ):
        return uniform.counts
    return _walk(body, element, start, element.count)


def _walk(body: Body, element: Element, start: int, rows: int) -> Int64s:
    """Find the lists one by one in a loop, since the offset of a list depends on all lists before it."""
    steps, gap = [], 0
    for prop in element.properties:
        size = body.size(prop.count or prop.type)
        if prop.count:
            steps.append((gap, body.view(prop.count).item, size, body.size(prop.type)))
        gap = 0 if prop.count else gap + size
    lengths = array("q")
    at = start
    try:
        for row in range(rows):
            for before, value_at, size, item_size in steps:
                length = value_at(at + before)
                if not 0 <= length <= body.stop or length != int(length):
                    cause = f"row {row} of element '{element.name}' has a list of {length:g} items"
                    raise InputError(body.name, cause)
                lengths.append(int(length))
                at += before + size + item_size * int(length)
            at += gap
    except IndexError:
        raise _cut_off(body, element) from None
    if at > body.stop:
        raise _cut_off(body, element)
    return np.frombuffer(lengths, np.int64).reshape(rows, -1)


def _cut_off(body: Body, element: Element) -> InputError:
    cause = (
        f"the data end before the {element.count} rows of element '{element.name}' that the header announces"
    )
    return InputError(body.name, cause, "the file is cut off or damaged")
