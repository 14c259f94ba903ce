"""New images for an OBJ file: their names, the libraries that name them, and its own `mtllib` lines."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.beside import renamed, respelled, unused, with_suffix
from beltrami_cli.formats.tokens import Spans, exchange_spans

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.obj.materials import Materials
    from beltrami_cli.mesh.textured import ImageFile, Slot


def repainted(
    materials: Materials,
    images: Mapping[tuple[Slot, str], ImageFile],
    source: str,
    stem: str,
    *,
    moved: bool,
) -> tuple[dict[str, Bytes], Spans]:
    """Return the new files beside an OBJ file, and what changes in itself.

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
    """
    taken = {path.casefold() for path in materials.paths}
    sidecars: dict[str, Bytes] = {}
    edits: dict[str, Spans] = {}
    for (slot, path), image in images.items():
        affected = list(materials.affected(slot, path))
        # Its name is free only if no map that keeps the old image has it.
        keeps = moved and len(affected) == materials.uses(path)
        new = with_suffix(path if keeps else renamed(path, source, stem), image.suffix)
        new = new if keeps and new == path else unused(new, taken)
        taken.add(new.casefold())
        sidecars[new] = image.data
        for library, found in affected:
            edits.setdefault(library.path, {})[found.start, found.end] = respelled(found.name, path, new)
    spans: Spans = {}
    for library in materials.libraries:
        data = exchange_spans(library.data, edits.get(library.path, {}))
        if data == library.data:
            continue
        new = library.path
        if not moved:
            new = unused(str(PurePosixPath(library.path).with_name(f"{stem}.mtl")), taken)
            taken.add(new.casefold())
            for name, start, end in library.mentions:
                spans[start, end] = respelled(name, library.path, new)
        sidecars[new] = data
    return sidecars, spans


def shifted(places: NDArray[np.int64], spans: Spans) -> NDArray[np.int64]:
    """Return where places outside the spans are after the exchange."""
    ordered = sorted(spans.items())
    growth = np.cumsum([0, *(len(new) - (end - start) for (start, end), new in ordered)])
    moved: NDArray[np.int64] = places + growth[np.searchsorted([start for (start, _), _ in ordered], places)]
    return moved
