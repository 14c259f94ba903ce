"""File names of tile sets.

The name of a tile set contains a token, which the names of its files replace by the number of the tile at column u and
row v:

| token | numbering | tile (2, 1) |
|---|---|---|
| `<UDIM>` | Mari: 1001 + u + 10 v, with u below 10 | 1013 |
| `<UVTILE>` | Mudbox: both counted from 1 | u3_v2 |
| `<uvtile>` | ZBrush: both counted from 0 | u2_v1 |
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from beltrami_cli.surface.tiling import COLUMNS, ROWS, Tile

_TOKEN = re.compile(r"<(udim|UDIM|UVTILE|uvtile)>")
_FIRST = 1001


def has_token(name: str) -> bool:
    return _TOKEN.search(name) is not None


def token_in(name: str) -> str:
    """Return the token of a name, with a dot in front; "" if it has none."""
    token = _TOKEN.search(name)
    return f".{token[0]}" if token else ""


def tile_name(pattern: str, tile: Tile) -> str:
    def number(token: re.Match[str]) -> str:
        if token[1].lower() == "udim":
            return str(_FIRST + tile[0] + COLUMNS * tile[1])
        first = int(token[1] == "UVTILE")
        return f"u{tile[0] + first}_v{tile[1] + first}"

    return _TOKEN.sub(number, pattern, count=1)


def found_tiles(pattern: str, names: Iterable[str]) -> dict[Tile, str]:
    """Return the tiles of a set among the names in a folder, row by row from the bottom."""
    token = _TOKEN.search(pattern)
    assert token is not None
    is_mari, first = token[1].lower() == "udim", int(token[1] == "UVTILE")
    label = r"([1-9]\d{3})" if is_mari else r"[uU](\d{1,3})_[vV](\d{1,3})"
    name_of = re.compile(re.escape(pattern[: token.start()]) + label + re.escape(pattern[token.end() :]))
    found: dict[Tile, str] = {}
    for match in filter(None, map(name_of.fullmatch, sorted(names))):
        u, v = int(match[1]) - first, int(match[match.re.groups]) - first
        if is_mari:
            v, u = divmod(u - _FIRST, COLUMNS)
        if 0 <= u < COLUMNS and 0 <= v < ROWS:
            found[u, v] = match[0]
    return dict(sorted(found.items(), key=lambda item: item[0][::-1]))
