"""New images for an OBJ file: their names, the libraries that name them, and its own `mtllib` lines."""

from __future__ import annotations

import os
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.model_folder import (
    is_outside,
    new_reference,
    path_inside,
    renamed,
    unused,
    with_suffix,
)
from beltrami_cli.formats.tokens import Spans, exchange_spans

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.obj.libraries import Map
    from beltrami_cli.formats.obj.materials import Library, Materials
    from beltrami_cli.surface.records import ImageFile, Slot


def repainted(
    materials: Materials,
    images: Mapping[tuple[Slot, str], ImageFile],
    source: str,
    stem: str,
    *,
    moved: bool,
) -> tuple[dict[str, Bytes], Spans, frozenset[str]]:
    """Return the new files beside an OBJ file, what changes in itself, and which old files nothing names any more.

    Parameters
    ----------
    materials : Materials
        Of the source.
    images : mapping of (Slot, str) to ImageFile
        New images by slot and path.
    source : str
        Stem of the source's name.
    stem, moved
        As for `Document.patch`.

    Returns
    -------
    sidecars : dict of str to bytes-like
        Images, and libraries in which names of images changed.
    spans : dict of (int, int) to bytes
        New names of libraries by where the old ones stand in the OBJ file.
    superseded : frozenset of str
        Images and libraries that have files of other names in their place.
    """
    taken = {path.casefold() for path in materials.paths}
    sidecars: dict[str, Bytes] = {}
    edits: dict[str, Spans] = {}
    superseded: set[str] = set()
    renamings: dict[str, int] = {}
    for (path, image), slots in _by_file(images).items():
        # What two slots show alike is one file; with the base colour go maps that are of other slots, too.
        affected = list(
            {id(found): (of, found) for s in slots for of, found in materials.affected(s, path)}.values()
        )
        # Its name is free only if no map that keeps the old image has it.
        keeps = moved and len(affected) == materials.uses(path)
        inside = path_inside(path)
        new = with_suffix(inside if keeps else renamed(inside, source, stem), image.suffix)
        new = new if keeps and new == path else _reserve(new, taken)
        taken.add(new.casefold())
        sidecars[new] = image.data
        renamings[path] = renamings.get(path, 0) + (len(affected) if new != path else 0)
        for library, found in affected:
            edits.setdefault(library.path, {})[found.start, found.end] = _spelled(found, path, new, library)
    superseded |= {path for path, count in renamings.items() if count == materials.uses(path)}
    spans: Spans = {}
    for library in materials.libraries:
        if library.path not in edits:
            continue
        new = library.path
        if not is_outside(new) and exchange_spans(library.data, edits[new]) == library.data:
            continue
        if is_outside(library.path):
            _take_along(materials, library, edits[library.path], sidecars, taken)
        if not moved or is_outside(library.path):
            new = _reserve(str(PurePosixPath(path_inside(library.path)).with_name(f"{stem}.mtl")), taken)
            for name, start, end in library.mentions:
                spans[start, end] = new_reference(name, library.path, new)
            superseded.add(library.path)
        sidecars[new] = exchange_spans(library.data, edits[library.path])
    return sidecars, spans, frozenset(superseded)


def _by_file(images: Mapping[tuple[Slot, str], ImageFile]) -> dict[tuple[str, ImageFile], list[Slot]]:
    """Return the slots in which an image is replaced by a file."""
    slots: dict[tuple[str, ImageFile], list[Slot]] = {}
    for (slot, path), image in images.items():
        slots.setdefault((path, image), []).append(slot)
    return slots


def _reserve(path: str, taken: set[str]) -> str:
    new = unused(path, taken)
    taken.add(new.casefold())
    return new


def _spelled(found: Map, path: str, new: str, library: Library) -> bytes:
    """Return how a library names an image that was at one path and is to be at another."""
    if is_outside(path) or is_outside(library.path):
        home = PurePosixPath(path_inside(library.path)).parent
        return os.fsencode("../" * len(home.parts) + new)
    return new_reference(found.name, path, new)


def _take_along(
    materials: Materials, library: Library, edits: Spans, sidecars: dict[str, Bytes], taken: set[str]
) -> None:
    """Make a library from outside the folder, which is written inside, find its other images from there."""
    copies: dict[str, str] = {}
    for found, path in library.maps:
        if path is None or (found.start, found.end) in edits:
            continue
        if path not in copies:
            copies[path] = _reserve(path_inside(path), taken) if is_outside(path) else path
            if is_outside(path):
                sidecars[copies[path]] = materials.read(path)
        edits[found.start, found.end] = os.fsencode(copies[path])


def shifted(places: NDArray[np.int64], spans: Spans) -> NDArray[np.int64]:
    """Return where places outside the spans are after the exchange."""
    ordered = sorted(spans.items())
    growth = np.cumsum([0, *(len(new) - (end - start) for (start, end), new in ordered)])
    moved: NDArray[np.int64] = places + growth[np.searchsorted([start for (start, _), _ in ordered], places)]
    return moved
