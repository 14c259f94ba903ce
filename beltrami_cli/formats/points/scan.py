"""What the readers of scanners' files have in common: their interface, and what they return."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Array

Arrays = dict[str, Array]


@dataclass(frozen=True)
class ScanContents:
    """All that a file of P points holds."""

    positions: Array  # (P, 3)
    colours: Array | None  # (P, 3): as stored; (P, 1): intensities
    fields: Mapping[str, Array]  # (P,): the further numbers of the points, by their names in the file
    rest: Mapping[str, Array]  # what else the file holds, such as its header
    normals: Array | None = None  # (P, 3)
    shape: tuple[int, ...] = ()  # of an organised cloud


class Scan(Protocol):
    """The points of a file."""

    def __init__(self, data: bytes) -> None: ...

    def contents(self) -> ScanContents: ...

    def written(self, new: Array | None, form: str) -> bytes:
        """Return the file, in one of its forms, with new colours or intensities (None: the same)."""


def colour_fields(fields: Mapping[str, Array], rgb: Sequence[str], intensity: str) -> tuple[str, ...]:
    """Return the fields that are colours: red, green and blue, or the intensity, or none."""
    has_colours = fields.keys() >= {*rgb} and any(fields[name].any() for name in rgb)
    if has_colours:  # all black where the scanner has no colours, as in LAS
        return tuple(rgb)
    return (intensity,) if intensity in fields else ()


def joined(fields: Mapping[str, Array], names: Sequence[str]) -> Array | None:
    """Return fields as the columns of a table; None without any names."""
    return np.column_stack([fields[name] for name in names]) if names else None


def require_room(count: int, size: int, room: int) -> None:
    """Raise ValueError if points, by number and size in bytes, exceed what a file can hold or unpack to."""
    if count * size > room:
        raise ValueError(f"there is no room for the {count} points that it announces")
