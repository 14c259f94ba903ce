"""What the writers of PLY and OBJ have in common: display colours, and words about what is dropped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.transfer import linear_to_srgb

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.surface.painted import MeshContents


def display_colours(contents: MeshContents) -> tuple[NDArray[np.float32], list[str]]:
    """Return red, green and blue as display values, and what to tell the user about it.

    Parameters
    ----------
    contents : MeshContents
        A mesh with one or three colour channels.

    Returns
    -------
    colours : ndarray of float32, shape (V, 3)
        sRGB values, full scale 1.
    notices : list of str
        One sentence for each thing that was changed.
    """
    colours, notices = contents.colours, []
    if contents.encoding == "linear":
        colours = linear_to_srgb(colours).astype(np.float32)
        notices.append("Linear colours are written as sRGB, which the format's colours are by custom.")
    if colours.shape[1] == 1:
        colours = np.repeat(colours, 3, axis=1)
        notices.append("Grey is written as equal red, green and blue.")
    return colours, notices


def left_out(contents: MeshContents) -> list[str]:
    """Return a sentence about what the conversion drops, or nothing."""
    return [f"Not converted: {'; '.join(contents.left_out)}."] if contents.left_out else []
