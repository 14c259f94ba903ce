"""Which stored number is full scale, of colours and of intensities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.scale import full_scale

if TYPE_CHECKING:
    from numpy.typing import NDArray

_WHOLE_SCALES = (255.0, 65535.0)


def colour_scale(values: NDArray[np.float64], name: str) -> tuple[float, str]:
    """Tell colours of 0..1, 0..255 and 0..65535.

    Parameters
    ----------
    values : ndarray of float64, shape (P, C)
        Finite stored numbers, at least one.
    name : str
        The file's name for messages.

    Returns
    -------
    scale : float
        The stored number that is full scale.
    notice : str
        What to tell the user about it; empty where there is hardly a doubt.

    Raises
    ------
    InputError
        As `full_scale`, where the numbers are not whole.
    """
    whole = _whole_scale(values)
    if whole is None:
        return full_scale(values, name)
    notice = f"Colours go up to {values.max():g} and are taken for numbers of 0..{whole:g}."
    return whole, notice if whole > _WHOLE_SCALES[0] else ""


def intensity_scale(values: NDArray[np.float64]) -> tuple[float, str]:
    """Choose a full scale for intensities, of which scanners write any.

    Parameters
    ----------
    values : ndarray of float64, shape (P, 1)
        Finite stored numbers, at least one.

    Returns
    -------
    scale, notice
        As for `colour_scale`; 1 for numbers of 0..1, else the largest magnitude where they are not whole and positive.
        What is smoothed does not depend on it, only what noise and changes are told in.
    """
    if values.min() >= 0 and values.max() <= 1:
        return 1.0, ""
    whole = _whole_scale(values)
    if whole is not None:
        return whole, ""
    largest = float(np.abs(values).max())
    low, high = values.min(), values.max()
    return largest, f"Intensities go from {low:g} to {high:g}; of full scale is what is {largest:g}."


def _whole_scale(values: NDArray[np.float64]) -> float | None:
    """Return the least usual full scale of whole numbers; None for others, and up to 1."""
    largest = float(values.max())
    if largest <= 1 or values.min() < 0 or (values % 1 != 0).any():
        return None
    return next((scale for scale in _WHOLE_SCALES if largest <= scale), None)
