"""What is new in an OBJ file: numbers on its `v` lines, and images, with the libraries and lines that name them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Bytes, Naming, Written
from beltrami_cli.formats.model_folder import NewNames, is_outside, new_reference, path_inside
from beltrami_cli.formats.textured_mesh import new_files, slots_by_path
from beltrami_cli.formats.tokens import Spans, exchange_spans, exchange_tokens
from beltrami_cli.surface.tiling import common_suffix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
    from beltrami_cli.formats.document import NewImages
    from beltrami_cli.formats.obj.materials import Library, Map, Materials

_DECIMALS = {1.0: (6, 9), 255.0: (4, 7)}  # by full scale, the least that lose nothing and the most of float32
_DIGITS = 8  # of the largest coordinate, at least: a little more than float32 has
_MOST_DECIMALS = 17


@dataclass(frozen=True)
class NewNumbers:
    """Tokens of a file and the numbers that replace them."""

    starts: Int64s  # (K,) where the tokens stand
    ends: Int64s
    values: Float64s
    decimals: int


def new_colours(
    data: bytes, starts: Int64s, ends: Int64s, colours: Float32s, changed: Bools, scale: float
) -> NewNumbers:
    """Format the colours that changed, all of shape (V, 3), like the old ones; `scale` is full scale, 1 or 255."""
    values = colours[changed].astype(np.float64) * scale
    decimals = 0
    found = _most_decimals(data, starts, ends) if len(values) else 0
    if found < 0 and scale != 1:
        values = np.clip(np.rint(values), 0, scale)
    else:
        least, most = _DECIMALS[scale]
        decimals = min(max(found, least), most)
    return NewNumbers(starts[changed], ends[changed], values, decimals)


def new_positions(
    data: bytes, starts: Int64s, ends: Int64s, positions: Float64s, changed: Bools
) -> NewNumbers:
    """Spell the coordinates that changed with as many decimals as the old ones, and no less than float32 has."""
    largest = float(np.abs(positions).max(initial=0)) or 1.0
    enough = _DIGITS - 1 - int(np.floor(np.log10(largest)))
    found = _most_decimals(data, starts, ends) if changed.any() else 0
    decimals = min(max(found, enough, 0), _MOST_DECIMALS)
    return NewNumbers(starts[changed], ends[changed], positions[changed], decimals)


def renumbered(data: bytes, parts: Sequence[NewNumbers]) -> list[Bytes]:
    """Exchange tokens for numbers, each token once, and keep every other byte; return the file in pieces."""
    starts = np.concatenate([part.starts for part in parts])
    if not len(starts):
        return [data]
    ends = np.concatenate([part.ends for part in parts])
    values = np.concatenate([part.values for part in parts])
    decimals = np.repeat([part.decimals for part in parts], [len(part.starts) for part in parts])
    order = np.argsort(starts)

    def spell(block: slice) -> list[bytes]:
        chosen = order[block]
        pairs = zip(decimals[chosen].tolist(), values[chosen].tolist(), strict=True)
        return [b"%.*f" % pair for pair in pairs]

    return [*exchange_tokens(data, starts[order], ends[order], spell)]


def _most_decimals(data: bytes, starts: Int64s, ends: Int64s) -> int:
    """Return how many characters stand behind the point at most; negative if no token has one."""
    points = np.append(np.flatnonzero(np.frombuffer(data, np.uint8) == ord(".")), len(data))
    return int((ends - points[np.searchsorted(points, starts)] - 1).max())


def repainted(materials: Materials, images: NewImages, source: str, naming: Naming) -> tuple[Written, Spans]:
    """Return the files beside an OBJ file, without the file itself, and the new names in it."""
    missing = [found.name for library in materials.libraries for found, path in library.maps if path is None]
    names = NewNames(naming, source, materials.paths, missing)
    sidecars: dict[str, Bytes] = {}
    copies: dict[str, str] = {}
    edits = _take_images(materials, images, names, sidecars, copies)
    if names.copies:
        copies |= _copy_images(materials, names, edits)
    spans: Spans = {}
    for library in materials.libraries:
        own = edits.get(library.path, {})
        outside = is_outside(library.path)
        is_new = bool(own) and (outside or exchange_spans(library.data, own) != library.data)
        if not is_new and (outside or not names.copies):
            continue
        if outside:
            _take_along(materials, library, own, sidecars, names)
        new = names.other(library.path, ".mtl")
        for name, start, end in library.mentions:
            spans[start, end] = new_reference(name, library.path, new)
        if is_new:
            sidecars[new] = exchange_spans(library.data, own)
        else:
            copies[new] = library.path
    return Written([], sidecars, copies=copies), spans


def _take_images(
    materials: Materials,
    images: NewImages,
    names: NewNames,
    sidecars: dict[str, Bytes],
    copies: dict[str, str],
) -> dict[str, Spans]:
    """Put new images among the sidecars, other tiles of their sets among the copies; return new names by library."""
    edits: dict[str, Spans] = {}
    for (path, files), slots in slots_by_path(images, lambda slot, file: materials.named(file)).items():
        # What two slots show alike is one file; with the base colour go maps that are of other slots, too.
        maps = [each for slot in slots for each in materials.affected(slot, path)]
        affected = list({id(found): (library, found) for library, found in maps}.values())
        # Its name is free only if no map that keeps the old image has it.
        is_replaced = len(affected) == materials.uses(path)
        suffix = common_suffix(image.suffix for _, image in files)
        new = names.image(path, suffix, is_replaced=is_replaced, tiles=materials.tiles.get(path, ()))
        new_of = new_files(path, new, materials.tiles)
        sidecars |= {new_of.pop(file): image.content for file, image in files}
        copies |= {file: old for old, file in new_of.items() if file != old}
        for library, found in affected:
            edits.setdefault(library.path, {})[found.start, found.end] = _spelled(found, path, new, library)
    return edits


def _copy_images(materials: Materials, names: NewNames, edits: dict[str, Spans]) -> dict[str, str]:
    """Name the images that stay as they are, in libraries inside the folder; return the old paths by the new ones."""
    new_of: dict[str, str] = {}
    for library in materials.libraries:
        for found, path in library.maps:
            if path is None or is_outside(path) or is_outside(library.path):
                continue
            own = edits.setdefault(library.path, {})
            if (found.start, found.end) not in own:
                if path not in new_of:
                    new_of[path] = names.image(path, tiles=materials.tiles.get(path, ()))
                own[found.start, found.end] = _spelled(found, path, new_of[path], library)
    files = [new_files(path, new, materials.tiles) for path, new in new_of.items()]
    return {file: old for of_path in files for old, file in of_path.items()}


def _spelled(found: Map, path: str, new: str, library: Library) -> bytes:
    """Return how a library names an image that was at one path and is to be at another."""
    climbs = ".." in PurePosixPath(found.name.replace("\\", "/")).parts
    if is_outside(path) or is_outside(library.path) or (climbs and new != path):
        home = PurePosixPath(path_inside(library.path)).parent
        return os.fsencode("../" * len(home.parts) + new)
    return new_reference(found.name, path, new)


def _take_along(
    materials: Materials, library: Library, edits: Spans, sidecars: dict[str, Bytes], names: NewNames
) -> None:
    """Make a library from outside the folder, which is written inside, find its other images from there."""
    copies: dict[str, str] = {}
    for found, path in library.maps:
        if path is None or (found.start, found.end) in edits:
            continue
        if path not in copies:
            is_copied = is_outside(path) or names.copies
            copies[path] = names.image(path, tiles=materials.tiles.get(path, ())) if is_copied else path
            if is_copied:
                new_of = new_files(path, copies[path], materials.tiles)
                sidecars |= {file: materials.read(old) for old, file in new_of.items()}
        edits[found.start, found.end] = os.fsencode(copies[path])
