"""Which number is full scale, where a file stores colours as numbers of any size."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_BYTE = 255.0
_BRIGHTEST = 16.0  # four stops above white: float colours beyond this are taken for 0..255


def full_scale(colours: NDArray[np.float64], name: str) -> tuple[float, str]:
    """Tell colours in [0, 1] from colours in [0, 255].

    Parameters
    ----------
    colours : ndarray of float64, shape (V, C)
        Finite stored numbers, at least one.
    name : str
        The file's name for messages.

    Returns
    -------
    scale : float
        255 if there are numbers above 1 and all are whole, or if one is above 16 (colours of high dynamic
        range may well leave [0, 1], but hardly so far); otherwise 1.
    notice : str
        What to tell the user about it; empty for numbers up to 1, which leave no doubt.

    Raises
    ------
    InputError
        If there are numbers beyond 255, up or down.
    """
    smallest, largest = float(colours.min()), float(colours.max())
    if largest > _BYTE or smallest < -_BYTE:
        cause = f"vertex colours go from {smallest:g} to {largest:g}, so that full scale is neither 1 nor 255"
        raise InputError(name, cause, "scale them to 0..1")
    if largest <= 1:
        return 1.0, ""
    if largest > _BRIGHTEST or bool((colours % 1 == 0).all()):
        return _BYTE, f"Vertex colours go up to {largest:g} and are taken for numbers of 0..255."
    return (
        1.0,
        f"Vertex colours go up to {largest:g} and are taken for numbers of 0..1 that leave this range.",
    )
