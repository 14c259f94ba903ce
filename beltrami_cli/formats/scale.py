"""Which number is full scale, where a file stores colours or intensities as numbers of any size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

BYTE = 255.0
_WHOLE_SCALES = (BYTE, 65535.0)
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
    if largest > BYTE or smallest < -BYTE:
        cause = f"vertex colours go from {smallest:g} to {largest:g}, so that full scale is neither 1 nor 255"
        raise InputError(name, cause, "scale them to 0..1")
    if largest <= 1:
        return 1.0, ""
    if largest > _BRIGHTEST or bool((colours % 1 == 0).all()):
        return BYTE, f"Vertex colours go up to {largest:g} and are taken for numbers of 0..255."
    return (
        1.0,
        f"Vertex colours go up to {largest:g} and are taken for numbers of 0..1 that leave this range.",
    )


def intensity_scale(values: NDArray[np.float64]) -> tuple[float, str]:
    """Choose a full scale for intensities, of which scanners write any.

    Parameters
    ----------
    values : ndarray of float64, shape (P, 1)
        Finite stored numbers, at least one.

    Returns
    -------
    scale, notice
        As for `full_scale`: 1 for numbers of 0..1, else the largest magnitude where they are not whole and positive.
        What is smoothed does not depend on it, only what noise and changes are told in.
    """
    if values.min() >= 0 and values.max() <= 1:
        return 1.0, ""
    whole = whole_scale(values)
    if whole is not None:
        return whole, ""
    largest = float(np.abs(values).max())
    low, high = values.min(), values.max()
    return largest, f"Intensities go from {low:g} to {high:g}; of full scale is what is {largest:g}."


def whole_scale(values: NDArray[np.float64]) -> float | None:
    """Return the least usual full scale of whole numbers, 255 or 65535; None for others, and for numbers up to 1."""
    largest = float(values.max())
    if largest <= 1 or values.min() < 0 or (values % 1 != 0).any():
        return None
    return next((scale for scale in _WHOLE_SCALES if largest <= scale), None)
