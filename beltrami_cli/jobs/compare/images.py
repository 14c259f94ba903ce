"""Two images, pixel by pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.compare.paired_colours import PairedColours, differences
from beltrami_cli.jobs.compare.textures import require_same_size, similarity
from beltrami_cli.jobs.noise.image import open_pixels
from beltrami_cli.samples.images.prepare import refuse_options_of_meshes
from beltrami_cli.samples.memory_check import require_room

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access
    from beltrami_cli.samples.settings.smooth import SmoothSettings


def pair_images(
    data: tuple[bytes, bytes], names: tuple[str, str], settings: SmoothSettings, access: Access
) -> tuple[PairedColours, tuple[int, int]]:
    """Bring two images together.

    Parameters
    ----------
    data, names : tuple of two
        The files, and their names for messages.
    settings : SmoothSettings
        The working space, the channels, and the mask.
    access : Access
        What may be read.

    Returns
    -------
    pair : PairedColours
        Of the pixels that can be seen in the reference, and are finite numbers there.
    size : (int, int)
        Rows and columns.

    Raises
    ------
    UsageError
        If the settings contradict the images.
    InputError
        If they cannot be decoded, or are not of one size and of the same channels.
    """
    refuse_options_of_meshes(settings, names[0])
    require_room(zip(names, data, strict=True), access)
    pictures = [read_image(each, name, finite=False) for each, name in zip(data, names, strict=True)]
    require_same_size(pictures[0], pictures[1], names[1])
    (one, valid), (other, _) = (open_pixels(picture, settings, access) for picture in pictures)
    if one.names != other.names:
        cause = f"it has the channels {', '.join(other.names)}, but {names[0]} {', '.join(one.names)}"
        raise InputError(names[1], cause, "compare images with the same channels, or choose with --channels")
    if not other.usable()[valid].all():
        count = int(np.count_nonzero(~other.usable()[valid]))
        raise InputError(names[1], f"{count} of its pixels are no finite numbers, but are in {names[0]}")
    pixels = np.flatnonzero(valid)
    colours = one.samples(pixels), other.samples(pixels)
    rows, columns = np.divmod(pixels, valid.shape[1])
    of_colours = settings.space if set(one.names) <= {"red", "green", "blue", "grey"} else "data"
    size = (valid.shape[0], valid.shape[1])
    pair = PairedColours(
        "image",
        "image",
        colours[0],
        colours[1],
        np.stack([columns, rows], axis=1),
        np.ones(len(pixels)),
        differences(colours[0], colours[1], of_colours),
        similarity(colours[0], colours[1], pixels, size),
    )
    return pair, size
