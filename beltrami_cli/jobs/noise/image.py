"""Noise on an image file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image import check_writable, is_exact, label_of, losses, read_image, write_image
from beltrami_cli.jobs.noise.kinds import add_noise
from beltrami_cli.jobs.opening import open_pixels
from beltrami_cli.samples.images.prepare import refuse_options_of_meshes
from beltrami_cli.samples.memory_check import require_room

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.jobs.settings import NoiseSettings
    from beltrami_cli.samples.settings import SmoothSettings


def noisy_image(
    data: bytes, name: str, suffix: str | None, settings: SmoothSettings, noise: NoiseSettings, access: Access
) -> tuple[Written, NDArray[np.float32]]:
    """Add noise to every pixel of an image that can be seen and is a finite number.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name for messages.
    suffix : str or None
        Extension of the format to write; None: its own.
    settings : SmoothSettings
        The working space, the channels, and the mask.
    noise : NoiseSettings
        What noise.
    access : Access
        What may be read.

    Returns
    -------
    written : Written
        The new file.
    change : ndarray of float32, shape (S, N)
        What was added to the colours in the working space.

    Raises
    ------
    UsageError
        If the settings contradict the image, or the format cannot be written.
    InputError
        If the image, or the mask, cannot be decoded or does not fit.
    """
    refuse_options_of_meshes(settings, name)
    require_room([(name, data)], access)
    picture = read_image(data, name, finite=False)
    check_writable(picture, suffix)
    colours, valid = open_pixels(picture, settings, access)
    pixels = np.flatnonzero(valid)
    before = colours.samples(pixels)
    after = add_noise(before, np.arange(len(pixels)), noise)
    repainted, _ = colours.repainted(pixels, after, threads=1)
    image = write_image(
        picture,
        repainted,
        suffix=suffix,
        jpeg_quality=settings.textures.jpeg_quality,
        small=settings.textures.small,
        as_data=settings.space == "data",
    )
    lost = () if suffix is None else losses(picture, suffix)
    lossy = lossy_notice(picture, suffix, "an OUTPUT in .png keeps all")
    return Written([image.data], notices=(*picture.notices, *lost, *lossy)), after - before


def lossy_notice(picture: Picture, suffix: str | None, remedy: str) -> tuple[str, ...]:
    """Return what to tell if an image is written in its own format, and that is not exact."""
    if suffix is not None or is_exact(picture):
        return ()
    kind = label_of(picture.format)
    return (
        f"{picture.name}: {kind} is not exact and takes some of the noise away, most of all in hues; {remedy}",
    )
