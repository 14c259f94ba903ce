"""The process that runs xatlas: asked with a mesh, it answers with texture coordinates.

xatlas reports nothing while it works, cannot be interrupted, and hangs on some meshes, so it gets a process that can be
ended. `beltrami_cli.surface.unwrap` starts it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.surface.worker_process import Message, serve

_COVERAGE = 0.75  # that xatlas expects of its packing when it is given a resolution
_ENOUGH = 0.92  # of the side of the texture that charts should fill
_TRIES = 8


def _answer(job: dict[str, Any], mesh: dict[str, Array]) -> Message:
    sizes, texels, padding = job["sizes"], job["texels"], job["padding"]
    corners, size, charts = unwrapped(mesh["positions"], mesh["faces"], sizes, texels, padding)
    return (size, charts), {"corners": corners}


def unwrapped(
    positions: Float32s, faces: NDArray[np.uint32], sizes: list[int], wanted: float, padding: int
) -> tuple[Float64s, int, int]:
    """Cut a mesh into charts and pack them; return corners in texels, shape (F, 3, 2), size and charts."""
    # `sizes` are longest sides, ascending: a single one is filled; of several the first is taken that is large enough
    # for as many texels as wanted, or else the last is filled. If charts do not fit even when tiny, corners
    # reach beyond the size.
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(positions, faces)
    packing = _packing(xatlas, padding, resolution=max(8, int(_COVERAGE * sizes[0])))
    atlas.generate(xatlas.ChartOptions(), packing)
    charts = int(atlas.chart_count)
    texels, corners = _packed(atlas)

    def packed(scale: float) -> tuple[Float64s, float]:
        again = xatlas.Atlas()
        again.add_uv_mesh(texels.astype(np.float32), corners)
        again.generate(xatlas.ChartOptions(), _packing(xatlas, padding, texels_per_unit=scale))
        places, theirs = _packed(again)
        return places[theirs], max(1.0, float(places.max()))

    scale, size = 1.0, sizes[-1]
    if len(sizes) > 1:
        possible = min(max(wanted, 1.0), float(size) ** 2)
        one, two = (texels[corners[:, k]] - texels[corners[:, 0]] for k in (1, 2))
        area = float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2)
        scale = float(np.sqrt(possible / max(area, 1.0)))
        places, side = packed(scale)
        if side <= size:
            return places, next(size for size in sizes if size >= side), charts
    return _filling(packed, scale, size), size, charts


def _filling(packed: Callable[[float], tuple[Float64s, float]], scale: float, size: int) -> Float64s:
    """Return the packing, of a few scales tried, that fills a side best and fits, or else the last."""
    best: tuple[Float64s, float] | None = None
    tried = packed(scale)
    for _ in range(_TRIES):
        if tried[1] <= size and (best is None or tried[1] > best[1]):
            best = tried
        if _ENOUGH * size <= tried[1] <= size:
            break
        # Packing is not monotonic: aim a little lower than what would fit exactly.
        scale *= 0.98 * size / tried[1]
        tried = packed(scale)
    return (best or tried)[0]


def _packing(xatlas: Any, padding: int, *, resolution: int = 0, texels_per_unit: float = 0.0) -> Any:
    options = xatlas.PackOptions()
    options.padding, options.bilinear = padding, True
    options.resolution, options.texels_per_unit = resolution, texels_per_unit
    return options


def _packed(atlas: Any) -> tuple[Float64s, NDArray[np.uint32]]:
    _, faces, uv = atlas.get_mesh(0)
    return uv.astype(np.float64) * [atlas.width, atlas.height], faces


if __name__ == "__main__":
    serve(_answer, int(sys.argv[1]))
