"""One vertex attribute of painted primitives, as it is stored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.surfaces import Block


@dataclass(frozen=True)
class Column:
    """Numbers that primitives share.

    Attributes
    ----------
    attribute : str
        "COLOR_0", "POSITION" or "NORMAL".
    accessor : int
        Where they are read.
    members : frozenset of int
        All accessors over these numbers that primitives name as this attribute.
    users : tuple of (int, int)
        Painted primitives that do, each by the index of its mesh and its own in that.
    position : int
        Accessor of the positions that they belong to.
    """

    attribute: str
    accessor: int
    members: frozenset[int]
    users: tuple[tuple[int, int], ...]
    position: int


def colour_column(block: Block) -> Column:
    """Return the colours of a block."""
    return Column("COLOR_0", block.colour, frozenset(block.members), tuple(block.users), block.position)
