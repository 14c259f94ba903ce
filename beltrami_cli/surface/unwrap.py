"""A new texture atlas for a mesh that has none: charts by xatlas, in a process that can be ended.

References
----------
.. [1] J. Young, "xatlas", https://github.com/jpcy/xatlas: charts grown over the surface, flattened by least squares
   conformal maps, packed in any rotation.
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int32s
from beltrami_cli.errors import InputError, ProcessingError
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import require_finite
from beltrami_cli.surface.worker_process import Message, working

Progress = Callable[[int, int], None] | None

_SIDES = [part * 2**k for k in range(6, 11) for part in (4, 5, 6, 7)]  # 256, 320, 384, 448, 512, 640 ...
_SIDES.append(8192)
_FLAT = 1e-6  # of the squared longest edge: what counts as a triangle without area, for single precision


@dataclass(frozen=True)
class Unwrapped:
    """A new atlas."""

    # Shape (F, 3, 2): texture coordinates of every corner in [0, 1], u to the right, v down. The corners of
    # a triangle without area all have one place.
    uv: Float64s
    size: tuple[int, int]  # width and height of the texture in texels
    charts: int  # how many


def unwrap(
    positions: Float64s, faces: Int32s, size: int | None, padding: int, name: str, *,
    texels: float = 0.0, space_of: Int32s | None = None, progress: Progress = None,
) -> Unwrapped:  # fmt: skip
    """Lay a mesh out on a square. Vertices at one place (and in one space) are one."""
    # `size`: longest side of the texture, in texels; None: up to 8192, as `texels`, which charts
    # should cover, need. `padding`: texels between charts, and around all of them. `progress` is called
    # several times a second with the elapsed and the expected tenths of a second.
    require_finite(positions, name, "the position of vertex")
    used, row_of = np.unique(faces, return_inverse=True)
    unit, rows = _of_unit_size(positions[used]), row_of.reshape(-1, 3).astype(np.int32)
    whole = _with_area(unit, rows)
    if not len(whole):
        raise InputError(name, "it has no triangle with an area", "nothing in it can be unwrapped")
    place_of, first = group_places(positions[used], None if space_of is None else space_of[used], rows)
    # Edges of about one unit are what xatlas' fixed tolerances suit.
    scaled = (np.sqrt(len(whole)) * unit[first]).astype(np.float32)
    triangles = place_of[rows[whole]].astype(np.uint32)
    sizes = [side - 2 * padding for side in (_SIDES if size is None else [size])]
    job = {"sizes": sizes, "texels": texels, "padding": padding}
    corners, inner, charts = ask_worker((job, {"positions": scaled, "faces": triangles}), progress)
    size = inner + 2 * padding
    if not np.isfinite(corners).all():
        raise ProcessingError(f"{name}: no texture coordinates can be found for it; repair the mesh first")
    largest = corners.reshape(-1, 2).max(axis=0)
    if largest.max() > inner:
        cause = f"its {charts} charts do not fit on a texture of {size} texels with {padding} between them"
        raise ProcessingError(f"{name}: {cause}; raise the size or lower the padding")
    width, height = (_side(reach + 2 * padding, size) for reach in largest.tolist())
    uv = np.empty((len(faces), 3, 2))
    uv[whole] = (corners + padding) / [width, height]
    _collapse_others(uv, faces, whole, len(positions))
    return Unwrapped(uv, (width, height), charts)


def require_few_faces(count: int, most: int, name: str) -> None:
    """Raise InputError if unwrapping this number of triangles would take longer than users allowed."""
    if count > most:
        seconds = expected_seconds(count)
        shown = f"{seconds / 60:.0f} minutes" if seconds >= 90 else f"{max(1.0, seconds):.0f} s"
        cause = f"it has {count} triangles, and unwrapping more than {most} takes long: about {shown}"
        remedy = f"simplify it, or allow it with --max-unwrap-faces {count}"
        raise InputError(name, f"{cause}, growing faster than their number", remedy)


def _of_unit_size(positions: Float64s) -> Float64s:
    """Bring positions into [-1/2, 1/2]; halves come first, so that nothing overflows."""
    if not len(positions):
        return positions
    low, high = positions.min(axis=0) / 2, positions.max(axis=0) / 2
    extent = float((high - low).max())
    return np.asarray((positions / 2 - (low + high) / 2) / (extent if extent > 0 else 1.0))


def _with_area(positions: Float64s, faces: Int32s) -> NDArray[np.intp]:
    edges = positions[faces] - positions[np.roll(faces, -1, axis=1)]
    longest = np.square(edges).sum(axis=2).max(axis=1, initial=0)
    distinct = (faces != np.roll(faces, -1, axis=1)).all(axis=1)
    return np.flatnonzero(distinct & (triangle_areas(positions, faces) > _FLAT * longest))


def _side(needed: float, size: int) -> int:
    """Halve the side of a texture as long as everything stays on it."""
    while needed <= size // 2 and size % 2 == 0:
        size //= 2
    return size


def _collapse_others(uv: Float64s, faces: Int32s, whole: NDArray[np.intp], vertices: int) -> None:
    """Give each triangle without area the one place that a corner of it has elsewhere, or the middle of nowhere."""
    place = np.zeros((vertices, 2))
    known = np.zeros(vertices, bool)
    place[faces[whole]], known[faces[whole]] = uv[whole], True
    others = np.ones(len(faces), bool)
    others[whole] = False
    corners = faces[others]
    chosen = np.take_along_axis(corners, known[corners].argmax(axis=1)[:, None], axis=1)
    uv[others] = place[chosen]


WORKER = "beltrami_cli.surface.unwrap_worker"
_POLL = 0.1  # seconds between looks at whether it is done or the user wants to stop
# Measured: 16 thousand triangles take 7 s, 82 thousand 109 s.
_SECONDS, _FACES, _GROWTH = 160.0, 100_000, 1.7
_PATIENCE = 10  # times as long as expected; beyond that it hangs
LEAST_PATIENCE = 120.0


def expected_seconds(faces: int) -> float:
    """Return how long unwrapping that many triangles takes."""
    return float(_SECONDS * (faces / _FACES) ** _GROWTH)


def ask_worker(mesh: Message, progress: Progress) -> tuple[Float64s, int, int]:
    """Have a mesh unwrapped; return corners in texels, shape (F, 3, 2), the side without margin, and charts."""
    expected = expected_seconds(len(mesh[1]["faces"]))
    patience = max(LEAST_PATIENCE, _PATIENCE * expected)
    with working(WORKER, mesh, int(patience) + 10) as worker:
        _wait(worker.process, patience, expected, progress)
        if (cause := worker.failure()) is not None:
            raise ProcessingError(f"xatlas could not unwrap the mesh ({cause}); repair or simplify it")
        (size, charts), arrays = worker.answer()
        return arrays["corners"], size, charts


def _wait(worker: subprocess.Popen[bytes], patience: float, expected: float, progress: Progress) -> None:
    start, total, is_done = time.monotonic(), max(1, int(10 * expected)), False
    while not is_done:
        with contextlib.suppress(subprocess.TimeoutExpired):
            worker.wait(_POLL)
            is_done = True
        gone = time.monotonic() - start
        if not is_done and gone > patience:
            cause = f"unwrapping did not end within {patience:.0f} s, though {expected:.0f} s are usual"
            raise ProcessingError(f"{cause}; repair or simplify the mesh")
        if progress is not None:
            progress(total if is_done else min(int(10 * gone), total), total)
