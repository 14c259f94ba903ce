"""The kernel of a texel."""

from __future__ import annotations

from fnmatch import fnmatch
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.mesh.atlas import EMPTY
from beltrami_cli.pipeline.kernel_study import KernelStudy, Shown, WindowView, describe, table
from beltrami_cli.pipeline.smooth_textures import prepare_slot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.one_kernel import SampledKernel
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.flow.texels import TexelFlow
    from beltrami_cli.formats.document import Document
    from beltrami_cli.mesh.atlas import Atlas
    from beltrami_cli.mesh.textured import Slot
    from beltrami_cli.pipeline.kernel_place import Place
    from beltrami_cli.pipeline.settings import SmoothSettings
    from beltrami_cli.pipeline.smooth_textures import PreparedSlot

# Cells around the window that are shown at least.
_LEAST_SURROUNDINGS = 4


def study_texel(
    document: Document,
    slot: Slot,
    place: Place,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
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

    Returns
    -------
    KernelStudy

    Raises
    ------
    UsageError
        If the place names no texel that takes part.
    """
    prepared = prepare_slot(document.textured(slot), slot, settings)
    index = _texture_at(prepared, place, document.name)
    picture, name = prepared.pictures[index], prepared.surface.textures[index].name
    height, width = picture.pixels.shape[:2]
    column, row = place.texel_of(width, height, name, v_down=document.format in ("gltf", "glb"))
    flow = prepared.flow(settings)
    texel = int(flow.atlas.texture_offsets[index]) + row * width + column
    cell = _cell_of(flow.atlas, texel, (column, row), name, width)
    flow.run(progress)
    kernel = flow.kernel_at(cell)
    textures, x, y = _texels_of(flow.atlas, kernel.samples, [p.pixels.shape[1] for p in prepared.pictures])
    names = np.array([texture.name for texture in prepared.surface.textures])
    columns: dict[str, NDArray[np.generic]] = {"texture": names[textures], "x": x, "y": y}
    shown = Shown(prepared.colours.names, prepared.colours.space)
    return study_cell(
        flow, kernel, shown, settings.kernel, {"at": f"texel {column},{row} of {name}"}, columns
    )


def study_cell(
    flow: TexelFlow,
    kernel: SampledKernel,
    shown: Shown,
    parameters: KernelParameters,
    facts: dict[str, object],
    columns: dict[str, NDArray[np.generic]],
) -> KernelStudy:
    """Put together what is known of a kernel on a canvas.

    Parameters
    ----------
    flow : TexelFlow
        What it was taken from.
    kernel : SampledKernel
        The kernel.
    shown : Shown
        What its colours mean.
    parameters : KernelParameters
        What the flow was run with.
    facts, columns : dict
        What is known of its place, and of each sample's.

    Returns
    -------
    KernelStudy
    """
    return KernelStudy(
        {**facts, **describe(kernel, shown, parameters, flow.beta)},
        {**columns, **table(kernel, shown)},
        parameters.radius,
        _view(flow, kernel, shown, parameters.window),
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


def _cell_of(atlas: Atlas, texel: int, at: tuple[int, int], name: str, width: int) -> int:
    """Find the cell of a texel; where it has none, tell the nearest that has."""
    (found,) = np.nonzero(atlas.owned_texels == texel)
    if len(found):
        return int(atlas.owned_cells[found[0]])
    first = texel - at[1] * width - at[0]
    later = atlas.texture_offsets[atlas.texture_offsets > first]
    mine = atlas.owned_texels[(atlas.owned_texels >= first) & (atlas.owned_texels < later[0])] - first
    message = f"the texel {at[0]},{at[1]} of {name} is not on the surface, or cannot be seen"
    if not len(mine):
        raise UsageError(f"{message}; nor is any other of this texture")
    y, x = np.divmod(mine, width)
    nearest = int(((x - at[0]) ** 2 + (y - at[1]) ** 2).argmin())
    raise UsageError(f"{message}; the nearest that is: {x[nearest]}px,{y[nearest]}px")


def _texels_of(
    atlas: Atlas, cells: NDArray[np.int64], widths: Sequence[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return texture, column and row of cells; a halo cell has those of the texel that it is nearest to."""
    own = cells.copy()
    place = np.searchsorted(atlas.halo_cells, cells)
    halo = place < len(atlas.halo_cells)
    halo[halo] = atlas.halo_cells[place[halo]] == cells[halo]
    taps = atlas.halo_weights[place[halo]].argmax(axis=1)
    own[halo] = atlas.halo_taps[place[halo], taps]
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, own)]
    textures = np.searchsorted(atlas.texture_offsets, texels, side="right") - 1
    y, x = np.divmod(texels - atlas.texture_offsets[textures], np.array(widths)[textures])
    return textures, x, y


def _view(flow: TexelFlow, kernel: SampledKernel, shown: Shown, window: int) -> WindowView:
    """Cut out what lies around a kernel."""
    reach = window // 2
    around = reach + max(reach, _LEAST_SURROUNDINGS)
    columns = flow.atlas.kind.shape[1]
    row, column = divmod(int(kernel.samples[0]), columns)
    filled = _patch(flow.atlas.kind, row, column, around) != EMPTY
    planes = _patch(flow.planes, row, column, around)
    distances = np.full(filled.shape, np.nan, np.float32)
    weights = np.zeros(filled.shape, np.float32)
    y, x = np.divmod(kernel.samples, columns)
    at = (y - row + around, x - column + around)
    distances[at], weights[at] = kernel.distances, kernel.weights
    shades = shown.shades(planes.reshape(len(planes), -1).T).reshape(*filled.shape, 3)
    return WindowView(shades, filled, distances, weights, (around, around))


def _patch(plane: NDArray[Any], row: int, column: int, around: int) -> NDArray[Any]:
    """Cut a square out of the last two axes, with zeros beyond the borders."""
    first = (max(0, row - around), max(0, column - around))
    part = plane[..., first[0] : row + around + 1, first[1] : column + around + 1]
    before = (first[0] - row + around, first[1] - column + around)
    missing = [(b, 2 * around + 1 - b - size) for b, size in zip(before, part.shape[-2:], strict=True)]
    return np.pad(part, [(0, 0)] * (plane.ndim - 2) + missing)
