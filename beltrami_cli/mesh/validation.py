"""What every painted mesh must fulfil before anything is computed on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.mesh.painted import PaintedVertices


def check_mesh(painted: PaintedVertices, name: str) -> None:
    """Check shapes, indices and finiteness.

    Parameters
    ----------
    painted : PaintedVertices
        The record to check.
    name : str
        Where it comes from, for the message.

    Raises
    ------
    InputError
        At the first thing that is wrong.
    """
    positions, faces, colours = painted.positions, painted.faces, painted.colours
    if positions.ndim != 2 or positions.shape[1] == 0:
        raise InputError(name, f"positions must be of shape (V, M), not {positions.shape}")
    if len(positions) != len(colours):
        raise InputError(name, f"there are {len(positions)} positions but {len(colours)} colours")
    if faces.size and (faces.min() < 0 or faces.max() >= len(positions)):
        raise InputError(name, f"a face names a vertex outside 0 to {len(positions) - 1}")
    _check_finite(positions, "position", name)
    _check_finite(colours, "colour", name)


def _check_finite(table: NDArray[np.floating], what: str, name: str) -> None:
    finite = np.isfinite(table).all(axis=1)
    if not finite.all():
        raise InputError(
            name, f"the {what} of vertex {int(np.argmin(finite))} is not finite", "repair the file"
        )
