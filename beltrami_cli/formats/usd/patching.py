"""Patch values in a stored layer, so that all other bytes stay unchanged.

The old ones are looked for by simple means. The result is read again and compared with the intended layer, so that
what was found in a wrong place is noticed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf

from beltrami_cli.arrays import Array
from beltrami_cli.formats.edits import Spans, exchange_spans

Values = tuple[list[Array], list[str]]  # the colours of meshes, and names of images
Change = tuple[Array, Array]  # the colours of a mesh before and after

_COLOURS = re.compile(rb"primvars:displayColor\s*=\s*\[([^\]]*)\]")
_VECTOR = re.compile(rb"\([^()]*\)")


def patched(stored: Path, layer: Any, before: Values, after: Values) -> bytes | None:
    """Return a stored layer with new values, equal to `layer`; None if it cannot be patched."""
    pairs = zip(before[0], after[0], strict=True)
    colours = [(old, new) for old, new in pairs if not np.array_equal(old, new)]
    names = list(dict.fromkeys(zip(before[1], after[1], strict=True)))
    data = stored.read_bytes()
    if data.startswith(b"PXR-USDC"):
        made = None if names else _in_binary(data, colours)
    else:
        made = _in_text(data, colours, names)
    return made if made is not None and _are_equal(layer, made, stored.suffix) else None


def _in_binary(data: bytes, colours: Sequence[Change]) -> bytes | None:
    """Replace arrays of vectors, which USDC stores without compression."""
    whole = bytearray(data)
    for before, after in colours:
        old, new = before.tobytes(), after.tobytes()
        at = whole.find(old)
        if len(old) != len(new) or at < 0 or whole.find(old, at + 1) >= 0:
            return None
        whole[at : at + len(old)] = new
    return bytes(whole)


def _in_text(data: bytes, colours: Sequence[Change], names: Sequence[tuple[str, str]]) -> bytes | None:
    """Replace the vectors that changed, and asset paths (between @)."""
    found = [(match.span(1), [*_VECTOR.finditer(match[1])]) for match in _COLOURS.finditer(data)]
    spans: Spans = {}
    for before, after in colours:
        fits = next((k for k, (_, each) in enumerate(found) if len(each) == len(before) == len(after)), None)
        if fits is None:
            return None
        (start, _), vectors = found.pop(fits)
        changed = np.flatnonzero((before != after).any(axis=1)).tolist()
        spans |= {(start + vectors[k].start(), start + vectors[k].end()): _spelled(after[k]) for k in changed}
    for old, new in names:
        pattern = re.compile(rb"(?<==)(\s*)@" + re.escape(old.encode()) + rb"@")
        spans |= {(match.end(1), match.end()): b"@%s@" % new.encode() for match in pattern.finditer(data)}
    return exchange_spans(data, spans)


def _spelled(colour: Array) -> bytes:
    """Return a colour as the shortest numbers that read back as the same."""
    return b"(" + b", ".join(str(value).encode() for value in colour.astype("U32").tolist()) + b")"


def _are_equal(layer: Any, data: bytes, suffix: str) -> bool:
    path = Path(f"patched{suffix}").absolute()
    path.write_bytes(data)
    made = Sdf.Layer.FindOrOpen(str(path))
    path.unlink()
    if made is None:
        return False
    paths, paths_made = list[Any](), list[Any]()
    layer.Traverse("/", paths.append)
    made.Traverse("/", paths_made.append)
    properties = [path for path in paths if path.IsPropertyPath()]
    return len(paths) == len(paths_made) and all(
        _value(layer, path) == _value(made, path) for path in properties
    )


def _value(layer: Any, path: Any) -> object:
    spec = layer.GetAttributeAtPath(path)
    return (spec.HasInfo("default"), spec.default) if spec else None
