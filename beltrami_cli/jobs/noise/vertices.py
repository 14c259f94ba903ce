"""Noise on vertex colours: one random number for each place, so that what a format splits stays together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.jobs.noise.kinds import add_noise
from beltrami_cli.jobs.opening import coloured_vertices
from beltrami_cli.samples.vertices.channels import choose_channels
from beltrami_cli.surface.grouping import group_places

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.settings import NoiseSettings
    from beltrami_cli.samples.settings import SmoothSettings


def noisy_vertices(
    document: Document, settings: SmoothSettings, noise: NoiseSettings
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Add noise to the vertex colours of a document.

    Parameters
    ----------
    document : Document
        With vertex colours.
    settings : SmoothSettings
        The working space and the channels.
    noise : NoiseSettings
        What noise.

    Returns
    -------
    colours : ndarray of float32, shape (V, C)
        New colours, as the document takes them back.
    change : ndarray of float32, shape (S, N)
        What was added to the colours in the working space, at the vertices that have one.

    Raises
    ------
    UsageError
        If the settings name channels that are not there.
    """
    painted = document.painted()
    channels = choose_channels(painted, settings).changing
    rows = np.flatnonzero(coloured_vertices(document))
    before = to_space(painted.colours[rows][:, channels], painted.encoding, settings.space)
    spaces = None if painted.space_of is None else painted.space_of[rows]
    place, _ = group_places(painted.positions[rows], spaces)
    after = add_noise(before, place, noise)
    back = from_space(after, painted.encoding, settings.space)
    colours = painted.colours.copy()
    changed = colours[rows]
    # The way to the working space and back is not exact: what did not change keeps its bits.
    changed[:, channels] = np.where(after != before, back, changed[:, channels])
    colours[rows] = changed
    return colours, after - before
