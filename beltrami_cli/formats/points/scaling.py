"""Which stored number is full scale, of the colours of points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.scale import BYTE, full_scale, whole_scale

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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
    whole = whole_scale(values)
    if whole is None:
        return full_scale(values, name)
    notice = f"Colours go up to {values.max():g} and are taken for numbers of 0..{whole:g}."
    return whole, notice if whole > BYTE else ""
