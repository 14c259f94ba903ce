"""Unwrapping: a new texture atlas by xatlas, in a process that can be killed.

xatlas reports no progress, cannot be interrupted, and hangs on some meshes. The process runs this module: it reads a
mesh and returns texture coordinates.

References
----------
.. [1] J. Young, "xatlas", https://github.com/jpcy/xatlas: charts grown over the surface, flattened by least squares
   conformal maps, packed in any rotation.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.errors import InputError, ProcessingError
from beltrami_cli.surface.geometry import scaled_to_unit, triangle_areas
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.precision import require_finite
from beltrami_cli.surface.worker_process import Message, WorkerError, ask, serve

Progress = Callable[[int, int], None] | None

_SIDES = [part * 2**k for k in range(6, 11) for part in (4, 5, 6, 7)]  # 256, 320, 384, 448, 512, 640 ...
_SIDES.append(8192)
_FLAT = 1e-6  # relative to the squared longest edge: a triangle without area in single precision


@dataclass(frozen=True)
class Unwrapped:
    # Shape (F, 3, 2): texture coordinates of every corner in [0, 1], u to the right, v down. All corners of a triangle
    # without area coincide.
    uv: Float64s
    size: tuple[int, int]  # width and height of the texture in texels
    charts: int  # number of charts


def unwrap(
    positions: Float64s, faces: Int32s, size: int | None, padding: int, name: str, *,
    texels: float = 0.0, space_of: Int32s | None = None, progress: Progress = None,
) -> Unwrapped:  # fmt: skip
    """Unwrap a mesh to a square. Coincident vertices of one space are joined.

    `size`: longest side of the texture in texels; None: up to 8192, so that charts cover `texels`. `padding`: texels
    between and around charts. `progress` is called several times a second with the elapsed and the expected tenths of a
    second.
    """
    require_finite(positions, name, "the position of vertex")
    used, row_of = np.unique(faces, return_inverse=True)
    unit, rows = scaled_to_unit(positions[used]) / 2, row_of.reshape(-1, 3).astype(np.int32)
    edges = unit[rows] - unit[np.roll(rows, -1, axis=1)]
    longest = np.square(edges).sum(axis=2).max(axis=1, initial=0)
    distinct = (rows != np.roll(rows, -1, axis=1)).all(axis=1)
    whole = np.flatnonzero(distinct & (triangle_areas(unit, rows) > _FLAT * longest))
    if not len(whole):
        raise InputError(name, "it has no triangle with an area", "nothing in it can be unwrapped")
    place_of, first = group_places(positions[used], None if space_of is None else space_of[used], rows)
    # The fixed tolerances of xatlas suit edges of about one unit.
    scaled = (np.sqrt(len(whole)) * unit[first]).astype(np.float32)
    triangles = place_of[rows[whole]].astype(np.uint32)
    sizes = [side - 2 * padding for side in (_SIDES if size is None else [size])]
    job = {"sizes": sizes, "texels": texels, "padding": padding}
    (inner, charts), answer = _ask_worker((job, {"positions": scaled, "faces": triangles}), progress)
    corners, side = answer["corners"], inner + 2 * padding
    if not np.isfinite(corners).all():
        raise ProcessingError("no texture coordinates can be found for it; repair the mesh first", name)
    largest = corners.reshape(-1, 2).max(axis=0)
    if largest.max() > inner:
        cause = f"its {charts} charts do not fit on a texture of {side} texels with {padding} between them"
        raise ProcessingError(f"{cause}; raise the size or lower the padding", name)
    width, height = (_shortened(side, reach + 2 * padding) for reach in largest.tolist())
    uv = np.empty((len(faces), 3, 2))
    uv[whole] = (corners + padding) / [width, height]
    _collapse_degenerate(uv, faces, whole, len(positions))
    return Unwrapped(uv, (width, height), charts)


def require_few_faces(count: int, most: int, name: str) -> None:
    """Raise InputError if unwrapping this number of triangles would exceed the time limit of users."""
    if count > most:
        seconds = expected_seconds(count)
        shown = f"{seconds / 60:.0f} minutes" if seconds >= 90 else f"{max(1.0, seconds):.0f} s"
        cause = f"it has {count} triangles, and unwrapping more than {most} takes long: about {shown}"
        remedy = f"simplify it, or allow it with --max-unwrap-faces {count}"
        raise InputError(name, f"{cause}, growing faster than their number", remedy)


def _shortened(side: int, needed: float) -> int:
    """Halve the side of a texture as long as it still fits `needed`."""
    while needed <= side // 2 and side % 2 == 0:
        side //= 2
    return side


def _collapse_degenerate(uv: Float64s, faces: Int32s, whole: NDArray[np.intp], vertices: int) -> None:
    """Give each triangle without area one texture coordinate: that of a corner in another triangle, or 0."""
    place = np.zeros((vertices, 2))
    known = np.zeros(vertices, bool)
    place[faces[whole]], known[faces[whole]] = uv[whole], True
    is_outside = np.ones(len(faces), bool)
    is_outside[whole] = False
    corners = faces[is_outside]
    chosen = np.take_along_axis(corners, known[corners].argmax(axis=1)[:, None], axis=1)
    uv[is_outside] = place[chosen]


WORKER = "beltrami_cli.surface.unwrap"
# Measured: 16 thousand triangles take 7 s, 82 thousand 109 s.
_SECONDS, _FACES, _GROWTH = 160.0, 100_000, 1.7
_TIMEOUT_FACTOR = 10  # times as long as expected; beyond that it hangs
MIN_TIMEOUT = 120.0


def expected_seconds(faces: int) -> float:
    return float(_SECONDS * (faces / _FACES) ** _GROWTH)


def _ask_worker(mesh: Message, progress: Progress) -> Message:
    expected = expected_seconds(len(mesh[1]["faces"]))
    patience, total = max(MIN_TIMEOUT, _TIMEOUT_FACTOR * expected), max(1, int(10 * expected))

    def tick(gone: float) -> None:
        if progress is not None:
            progress(min(int(10 * gone), total), total)

    try:
        answer = ask(WORKER, mesh, int(patience) + 10, seconds=patience, tick=tick)
    except TimeoutError:
        cause = f"unwrapping did not end within {patience:.0f} s, though {expected:.0f} s are usual"
        raise ProcessingError(f"{cause}; repair or simplify the mesh") from None
    except WorkerError as error:
        raise ProcessingError(f"xatlas could not unwrap the mesh ({error}); repair or simplify it") from error
    tick(expected + 1)
    return answer


_COVERAGE = 0.75  # assumed by xatlas for packing with a given resolution
_MAX_ATTEMPTS = 8


def cut_and_pack(
    positions: Float32s, faces: NDArray[np.uint32], sizes: list[int], wanted: float, padding: int
) -> tuple[Float64s, int, int]:
    """Cut a mesh into charts and pack them; return corners in texels, shape (F, 3, 2), size and number of charts."""
    # `sizes` are longest sides, ascending. A single size is filled. Of several, the first that holds the wanted number
    # of texels is used, or else the last is filled. If charts do not fit even when tiny, corners exceed the size.
    texels, corners, charts = _generated(
        "add_mesh", (positions, faces), padding, resolution=max(8, int(_COVERAGE * sizes[0]))
    )

    def packed(scale: float) -> tuple[Float64s, float]:
        mesh = texels.astype(np.float32), corners
        places, corners_of, _ = _generated("add_uv_mesh", mesh, padding, texels_per_unit=scale)
        return places[corners_of], max(1.0, float(places.max()))

    scale, size = 1.0, sizes[-1]
    if len(sizes) > 1:
        possible = min(max(wanted, 1.0), float(size) ** 2)
        one, two = (texels[corners[:, k]] - texels[corners[:, 0]] for k in (1, 2))
        area = float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2)
        scale = float(np.sqrt(possible / max(area, 1.0)))
        places, side = packed(scale)
        if side <= size:
            return places, next(size for size in sizes if size >= side), charts
    else:
        side = max(1.0, float(texels.max()))
    for _ in range(_MAX_ATTEMPTS):
        # Packing is not monotonic: aim slightly below an exact fit.
        scale *= 0.98 * size / side
        places, side = packed(scale)
        if side <= size:
            break
    return places, size, charts


def _generated(
    add: str, mesh: tuple[Array, Array], padding: int, **packing: float
) -> tuple[Float64s, NDArray[np.uint32], int]:
    """Cut a mesh into charts unless it has texture coordinates, and pack them; return texels, faces and charts."""
    import xatlas

    atlas, options = xatlas.Atlas(), xatlas.PackOptions()
    getattr(atlas, add)(*mesh)
    options.padding, options.bilinear = padding, True
    for name, value in packing.items():
        setattr(options, name, value)
    atlas.generate(xatlas.ChartOptions(), options)
    _, faces, uv = atlas.get_mesh(0)
    return uv.astype(np.float64) * [atlas.width, atlas.height], faces, int(atlas.chart_count)


def _answer(job: dict[str, Any], mesh: dict[str, Array]) -> Message:
    sizes, texels, padding = job["sizes"], job["texels"], job["padding"]
    corners, size, charts = cut_and_pack(mesh["positions"], mesh["faces"], sizes, texels, padding)
    return (size, charts), {"corners": corners}


if __name__ == "__main__":
    serve(_answer, int(sys.argv[1]))
