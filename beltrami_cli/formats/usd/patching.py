"""New values put into a stored layer where the old ones stand, so that every other byte stays.

What comes out is read again and compared with the layer as it should be: where anything else differs, nothing is
returned, and the layer is written anew. So values may be looked for by simple means.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Array

    Change = tuple[Array, Array]  # the values of an attribute before and after

_COLOURS = re.compile(rb"primvars:displayColor\s*=\s*\[([^\]]*)\]")
_VECTOR = re.compile(rb"\([^()]*\)")


def in_place(
    data: bytes, suffix: str, layer: Any, colours: Sequence[Change], names: Sequence[tuple[str, str]]
) -> bytes | None:
    """Return a stored layer with other colours and names of images, equal to `layer`; None if that cannot be."""
    if data.startswith(b"PXR-USDC"):
        made = None if names else _in_binary(data, colours)
    else:
        made = _in_text(data, colours, names)
    return made if made is not None and _are_equal(layer, made, suffix) else None


def _in_binary(data: bytes, colours: Sequence[Change]) -> bytes | None:
    """Exchange arrays, which are stored as they are if they are of vectors."""
    whole = bytearray(data)
    for before, after in colours:
        old, new = before.tobytes(), after.tobytes()
        at = whole.find(old)
        if len(old) != len(new) or at < 0 or whole.find(old, at + 1) >= 0:
            return None
        whole[at : at + len(old)] = new
    return bytes(whole)


def _in_text(data: bytes, colours: Sequence[Change], names: Sequence[tuple[str, str]]) -> bytes | None:
    """Exchange the vectors that changed, and names between @."""
    found = [(match.span(1), [*_VECTOR.finditer(match[1])]) for match in _COLOURS.finditer(data)]
    spans: list[tuple[int, int, bytes]] = []
    for before, after in colours:
        fits = next((k for k, (_, each) in enumerate(found) if len(each) == len(before) == len(after)), None)
        if fits is None:
            return None
        (start, _), vectors = found.pop(fits)
        changed = np.flatnonzero((before != after).any(axis=1)).tolist()
        spans += [(start + vectors[k].start(), start + vectors[k].end(), _spelled(after[k])) for k in changed]
    for old, new in names:
        pattern = re.compile(rb"(?<==)(\s*)@" + re.escape(old.encode()) + rb"@")
        spans += [(match.end(1), match.end(), b"@" + new.encode() + b"@") for match in pattern.finditer(data)]
    pieces, at = [], 0
    for start, end, new_text in sorted(spans):
        pieces += [data[at:start], new_text]
        at = end
    return b"".join([*pieces, data[at:]])


def _spelled(colour: Array) -> bytes:
    """Return the shortest numbers that are read back the same."""
    return b"(" + b", ".join(str(value).encode() for value in colour.astype("U32").tolist()) + b")"


def _are_equal(layer: Any, data: bytes, suffix: str) -> bool:
    """Return whether a stored layer holds what another one does."""
    from pxr import Sdf

    path = Path(f"patched{suffix}").absolute()
    path.write_bytes(data)
    made = Sdf.Layer.FindOrOpen(str(path))
    path.unlink()
    if made is None:
        return False
    paths: list[Any] = []
    layer.Traverse("/", paths.append)
    count: list[Any] = []
    made.Traverse("/", count.append)
    return len(paths) == len(count) and all(
        _value(layer, path) == _value(made, path) for path in paths if path.IsPropertyPath()
    )


def _value(layer: Any, path: Any) -> object:
    spec = layer.GetAttributeAtPath(path)
    return (spec.HasInfo("default"), spec.default) if spec else None
