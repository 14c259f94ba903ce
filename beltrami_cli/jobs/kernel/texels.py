"""The kernel of a texel."""

from __future__ import annotations

from fnmatch import fnmatch
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.jobs.kernel.cells import find_cell, study_cell
from beltrami_cli.jobs.kernel.study import KernelStudy, Shown
from beltrami_cli.samples.textures.prepare import prepare_slot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.kernel.place import Place
    from beltrami_cli.samples.settings.smooth import SmoothSettings
    from beltrami_cli.samples.textures.prepare import PreparedSlot
    from beltrami_cli.surface.atlas import Atlas
    from beltrami_cli.surface.records import Slot


def study_texel(
    document: Document,
    slot: Slot,
    place: Place,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> KernelStudy:
    """Study the kernel of a texel after the iterations that the settings ask for.

    Parameters
    ----------
    document : Document
        With textures in the slot.
    slot : Slot
        Which textures are smoothed together.
    place : Place
        A texel of one of them.
    settings : SmoothSettings
        As for smoothing.
    progress : callable, optional
        Of the iterations before.
    access : Access
        What may be read, for guides.

    Returns
    -------
    KernelStudy

    Raises
    ------
    UsageError
        If the place names no texel that takes part.
    """
    prepared = prepare_slot(document.textured(slot), slot, settings, document, access)
    index = _texture_at(prepared, place, document.name)
    picture, name = prepared.pictures[index], prepared.surface.textures[index].name
    height, width = picture.pixels.shape[:2]
    column, row = place.texel_of(width, height, name, v_down=document.format in ("gltf", "glb"))
    flow = prepared.flow(settings)
    cell = find_cell(flow.manifold.atlas, index, column, row, width, f"the texel {column},{row} of {name}")
    flow.run(progress)
    kernel = flow.kernel_at(cell)
    textures, x, y = _texels_of(
        flow.manifold.atlas, kernel.samples, [p.pixels.shape[1] for p in prepared.pictures]
    )
    names = np.array([texture.name for texture in prepared.surface.textures])
    columns: dict[str, NDArray[np.generic]] = {"texture": names[textures], "x": x, "y": y}
    shown = Shown(prepared.colours.names, prepared.colours.space)
    return study_cell(
        flow, kernel, shown, settings.kernel, {"at": f"texel {column},{row} of {name}"}, columns
    )


def _texture_at(prepared: PreparedSlot, place: Place, name: str) -> int:
    """Choose the texture that a place is in."""
    textures = [texture.name for texture in prepared.surface.textures]
    fits = [i for i, texture in enumerate(textures) if not place.texture or fnmatch(texture, place.texture)]
    if len(fits) == 1:
        return fits[0]
    which = "several textures" if fits else "no texture"
    raise UsageError(
        f"--at {place.text} names {which} of {name}; write one of {', '.join(textures)} before it, as in "
        f"{textures[0]}:{place.text.rpartition(':')[2]}"
    )


def _texels_of(
    atlas: Atlas, cells: NDArray[np.int64], widths: Sequence[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return texture, column and row of cells; a halo cell has those of the texel that it is nearest to."""
    own = cells.copy()
    place = np.searchsorted(atlas.halo_cells, cells)
    halo = place < len(atlas.halo_cells)
    halo[halo] = atlas.halo_cells[place[halo]] == cells[halo]
    own[halo] = atlas.halo_nearest[place[halo]]
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, own)]
    textures = np.searchsorted(atlas.texture_offsets, texels, side="right") - 1
    y, x = np.divmod(texels - atlas.texture_offsets[textures], np.array(widths)[textures])
    return textures, x, y
