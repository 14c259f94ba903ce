"""Images in tiles: names with a token in the place of a tile's number, and the files of such a set.

The UV plane is cut into unit squares, tile (u, v) with its lower left corner at (u, v), and each has a file of its own.

| token | numbering | tile (2, 1) |
|---|---|---|
| `<UDIM>` | Mari: 1001 + u + 10 v, with u below 10 | 1013 |
| `<UVTILE>` | Mudbox: both counted from 1 | u3_v2 |
| `<uvtile>` | ZBrush: both counted from 0 | u2_v1 |
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from beltrami_cli.surface.tiling import COLUMNS, ROWS, Tile

if TYPE_CHECKING:
    from collections.abc import Iterable

_TOKEN = re.compile(r"<(udim|UDIM|UVTILE|uvtile)>")
_FIRST = 1001
_NUMBER = re.compile(r"[1-9]\d{3}")
_PAIR = re.compile(r"[uU](\d{1,3})_[vV](\d{1,3})")


def has_token(name: str) -> bool:
    """Whether a name stands for a set of tiles."""
    return _TOKEN.search(name) is not None


def token_in(name: str) -> str:
    """Return what stands for the number of a tile in a name, with a dot in front; "" if nothing does."""
    token = _TOKEN.search(name)
    return f".{token[0]}" if token else ""


def tile_of(pattern: str, name: str) -> Tile | None:
    """Return which tile of a set a file is, going by both names without folders; None if it is none of them."""
    token = _TOKEN.search(pattern)
    assert token is not None
    before, after = pattern[: token.start()], pattern[token.end() :]
    if len(name) < len(pattern) - len(token[0]) or not name.startswith(before) or not name.endswith(after):
        return None
    label = name[len(before) : len(name) - len(after)]
    if token[1].lower() == "udim":
        if not _NUMBER.fullmatch(label) or int(label) < _FIRST:
            return None
        v, u = divmod(int(label) - _FIRST, COLUMNS)
        return u, v
    pair = _PAIR.fullmatch(label)
    first = int(token[1] == "UVTILE")
    if pair is None or min(int(pair[1]), int(pair[2])) < first:
        return None
    u, v = int(pair[1]) - first, int(pair[2]) - first
    return (u, v) if u < COLUMNS and v < ROWS else None


def tile_name(pattern: str, tile: Tile) -> str:
    """Return the name of a tile's file."""

    def number(token: re.Match[str]) -> str:
        if token[1].lower() == "udim":
            return str(_FIRST + tile[0] + COLUMNS * tile[1])
        first = int(token[1] == "UVTILE")
        return f"u{tile[0] + first}_v{tile[1] + first}"

    return _TOKEN.sub(number, pattern, count=1)


def found_tiles(pattern: str, names: Iterable[str]) -> dict[Tile, str]:
    """Return the tiles of a set among the names of a folder, row by row from below."""
    found = {tile: name for name in sorted(names) if (tile := tile_of(pattern, name)) is not None}
    return dict(sorted(found.items(), key=lambda item: item[0][::-1]))


def usual_tiles(pattern: str) -> list[str]:
    """Return the names of the hundred tiles that a set has at most in practice, for storage that is not listed."""
    return [tile_name(pattern, (u, v)) for v in range(10) for u in range(COLUMNS)]


def common_suffix(suffixes: Iterable[str]) -> str | None:
    """Return the suffix that all tiles of a set have; None if they differ, so that their name cannot have it."""
    distinct = set(suffixes)
    return distinct.pop() if len(distinct) == 1 else None
