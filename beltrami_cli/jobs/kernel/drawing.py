"""Draw a kernel: on the mesh, or in panels around the sample of an image, bright where it is near."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.manifolds.grid.manifold import GridManifold
from beltrami_cli.flow.manifolds.iteration import SampledKernel
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.ply.writer import write_scalars_as_ply
from beltrami_cli.layers.layer import Layer, SampledVertices
from beltrami_cli.surface.atlas import EMPTY
from beltrami_cli.surface.colour_map import as_bytes, colour_by_value
from beltrami_cli.surface.colour_values import from_space

_ZOOM, _GAP = 28, 12  # pixels of a cell in an image, and between its panels
_SURROUNDINGS = 4  # cells that are shown around the window


def draw_on_mesh(
    where: SampledVertices, colours: Float32s, kernel: SampledKernel, nearness: Float32s, layer: Layer
) -> Written:
    """Colour the whole mesh by nearness, with distance (NaN beyond the kernel) and weight as properties."""
    greys = _greys(colours, layer)
    rows = np.full((len(greys), 3), [np.nan, np.nan, 0], np.float32)
    rows[kernel.samples] = np.column_stack([nearness, kernel.distances, kernel.weights])
    near, distance, weight = rows.T
    shades = as_bytes(colour_by_value(near, greys, np.isfinite(near)))
    sample_of, mesh = where.sample_of, where.mesh
    scalars = {"distance": distance[sample_of], "weight": weight[sample_of]}
    return write_scalars_as_ply(mesh.positions, mesh.faces, shades[sample_of], scalars)


def draw_in_image(
    manifold: GridManifold, index: int, kernel: SampledKernel, nearness: Float32s, layer: Layer, suffix: str
) -> Written:
    """Draw the canvas around a sample three times: its colours, the nearness, the weights."""
    atlas, offsets = manifold.geometry.atlas, kernel.offsets
    assert offsets is not None
    around = manifold.parameters.window // 2 + _SURROUNDINGS
    row, column = divmod(int(atlas.owned_cells[index]), atlas.kind.shape[1])
    place = np.s_[..., row : row + 2 * around + 1, column : column + 2 * around + 1]
    edge = [(around, around)] * 2
    filled = np.pad(atlas.kind, edge, constant_values=EMPTY)[place] != EMPTY
    colours = np.pad(manifold.colours, [(0, 0), *edge])[place]
    working = manifold.noise.to_input(colours.reshape(len(colours), -1).T)
    greys = _greys(working, layer).reshape(*filled.shape, 3)
    panels = [greys.astype(np.float64)]
    for values in (nearness, kernel.weights / kernel.weights.max()):
        shown = np.full(filled.shape, np.nan, np.float32)
        shown[tuple(offsets.T + around)] = values
        panels.append(colour_by_value(shown, greys, np.isfinite(shown)))
    drawn = [np.where(filled[..., None], panel, 1.0).repeat(_ZOOM, 0).repeat(_ZOOM, 1) for panel in panels]
    gap = np.ones((len(drawn[0]), _GAP, 3))
    pixels = as_bytes(np.hstack([drawn[0], gap, drawn[1], gap, drawn[2]]))
    return Written([write_image(new_image(pixels, "kernel"), pixels, suffix=suffix).data])


def _greys(colours: Float32s, layer: Layer) -> Float32s:
    """Convert working colours, (S, N), to display values, (S, 3); data by the range of the first channel."""
    if layer.names[0] in ("red", "grey"):
        shown = from_space(colours[:, : 3 if len(layer.names) > 2 else 1], "srgb", layer.settings.space)
    else:
        low, high = colours[:, :1].min(initial=np.inf), colours[:, :1].max(initial=-np.inf)
        shown = (colours[:, :1] - low) / max(high - low, np.float32(1e-30))
    return np.clip(np.broadcast_to(shown, (len(shown), 3)), 0, 1)
