"""Seams whose two sides really differ, told from seams that are only noisy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.mesh.atlas import OWNED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.mesh.atlas import Atlas

# A jump counts if it is this many standard errors of the mean over the seam ...
_ERRORS = 4.0
# ... and this much of the noise: below, averaging over the seam still wins more (noise) than it loses (bias) ...
_OF_NOISE = 0.6
# ... and more than JPEG blocks and rounding leave between two charts of one continuous painting.
_LEAST = 4 / 255
# Where a pattern runs into the seam the jump changes its sign; then the typical step tells, against that beside it.
_OF_STEPS = 2.5


def find_colour_jumps(
    atlas: Atlas, planes: NDArray[np.float32], sigma: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Decide for each seam whether its two sides differ by more than noise.

    Parameters
    ----------
    atlas : Atlas
        The atlas with S seams.
    planes : ndarray of float32, shape (N, R, C)
        Colours on the canvas, halo included.
    sigma : ndarray of float64, shape (N,)
        Noise per channel.

    Returns
    -------
    ndarray of bool, shape (S,)
        True where the seam is a real edge of the painting.
    """
    different = np.zeros(max(1, atlas.seams), bool)
    seam, steps, beside = _steps_over_seams(atlas, planes)
    if not len(seam):
        return different
    order = np.argsort(seam, kind="stable")
    starts = np.flatnonzero(np.r_[True, seam[order][1:] != seam[order][:-1]])
    noise = float(np.sqrt(np.mean(np.square(sigma))))
    for first, last in zip(starts, np.r_[starts[1:], len(seam)], strict=True):
        members = order[first:last]
        jump = np.abs(np.median(steps[members], axis=0)).max()
        # A step between two noisy samples has the deviation sqrt(2) sigma, and a median 1.25 times a mean's error.
        error = 1.25 * np.sqrt(2) * noise / np.sqrt(len(members))
        shifted = jump > max(_ERRORS * error, _OF_NOISE * noise, _LEAST)
        across = np.median(np.linalg.norm(steps[members], axis=1))
        within = np.median(np.linalg.norm(beside[members], axis=1))
        patterned = len(members) >= 8 and across > _OF_STEPS * within + max(_LEAST, _OF_NOISE * noise)
        different[seam[members[0]]] = shifted or patterned
    return different


def _steps_over_seams(
    atlas: Atlas, planes: NDArray[np.float32]
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Find the halo cells next to an owned cell: their seam, the step to them, and the step before it."""
    rows, columns = atlas.kind.shape
    flat_kind, flat = atlas.kind.reshape(-1), planes.reshape(len(planes), -1)
    seams: list[NDArray[np.int32]] = []
    over: list[NDArray[np.float32]] = []
    before: list[NDArray[np.float32]] = []
    cells = atlas.halo_cells[atlas.halo_seams >= 0]
    halo_seams = atlas.halo_seams[atlas.halo_seams >= 0]
    for step in (1, -1, columns, -columns):
        inner, second = cells - step, cells - 2 * step
        valid = (second >= 0) & (second < rows * columns) & (inner >= 0) & (inner < rows * columns)
        valid[valid] &= (flat_kind[inner[valid]] == OWNED) & (flat_kind[second[valid]] == OWNED)
        seams.append(halo_seams[valid])
        over.append((flat[:, cells[valid]] - flat[:, inner[valid]]).T)
        before.append((flat[:, inner[valid]] - flat[:, second[valid]]).T)
    return np.concatenate(seams), np.concatenate(over), np.concatenate(before)
