"""New values in the body of a PLY file, binary or text, whose other bytes stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Int64s
from beltrami_cli.formats import edits
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.ply.header import Header
from beltrami_cli.formats.ply.tables import Places, indices, values_in_bytes
from beltrami_cli.formats.tokens import find_tokens


@dataclass(frozen=True)
class NewValues:
    """New values of one property."""

    places: Places  # positions of a scalar property in all rows
    rows: Bools  # which rows change
    values: Array  # their new values, in the property's type


def patched_body(data: bytes, header: Header, changes: Sequence[NewValues]) -> list[Bytes]:
    """Replace values in the body (at least one, each property once), and return it in pieces; other bytes stay."""
    if not header.order:
        text = data[header.end :]
        starts, ends = find_tokens(text)
        places = [indices(change.places)[change.rows] for change in changes]
        both = zip(places, changes, strict=True)
        new = [edits.NewNumbers(starts[at], ends[at], change.values) for at, change in both]
        return [*edits.renumbered(text, new)]
    patched = bytearray(data)
    for change in changes:
        everywhere = values_in_bytes(patched, header.order + change.values.dtype.str[1:])
        where = change.places
        if isinstance(where, slice):
            everywhere[where][change.rows] = change.values
        else:
            everywhere[where[change.rows]] = change.values
    return [memoryview(patched)[header.end :]]


def hidden_values(data: bytes, header: Header, units: Int64s, size: int) -> bytes:
    """Return the body without the values of `size` bytes, or the tokens, at some units."""
    if header.order:
        return edits.zeroed(data, units, size)[header.end :]
    text, units = data[header.end :], np.sort(units)
    starts, ends = find_tokens(text)
    return edits.without_tokens(text, starts[units], ends[units])
