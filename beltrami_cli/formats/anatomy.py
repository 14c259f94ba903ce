"""What a file is made of, colours and images apart from all the rest, so that two files can be compared."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

HIDDEN = b"\0"
"""What stands in a part where something was taken out that may differ."""


@dataclass(frozen=True)
class Painting:
    """An image file, by the name that people know it by."""

    name: str
    data: bytes


@dataclass(frozen=True)
class Anatomy:
    """A file taken apart.

    Attributes
    ----------
    parts : mapping of str to bytes
        Everything that is neither colour nor image, by its place in the file. Where a colour, an image or the name of
        its file stands, there is only a placeholder: files that differ in nothing but colours have equal parts.
    colours : mapping of str to ndarray of float32, shape (n, C)
        The colours, full scale 1, by what they are.
    paintings : mapping of str to Painting
        The images, by where they are used.
    """

    parts: Mapping[str, bytes]
    colours: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    paintings: Mapping[str, Painting] = field(default_factory=dict)


def blanked(data: bytes, places: NDArray[np.int64], size: int) -> bytes:
    """Return data in which some values are zero.

    Parameters
    ----------
    data : bytes
        All bytes.
    places : ndarray of int64, shape (n,)
        Where values start.
    size : int
        Bytes of each.
    """
    octets: NDArray[Any] = np.frombuffer(data, np.uint8).copy()
    for step in range(size):
        octets[places + step] = 0
    return octets.tobytes()
