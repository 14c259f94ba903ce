"""Opening the input of a job: a model as it is, or a level set, which is triangulated first."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.registry import document_of, kind_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.images.colours import ImageColours
    from beltrami_cli.samples.settings import SmoothSettings


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input, as the document that it is."""
    return document_from(read_source(source, access), source, settings, access)


def document_from(data: bytes, source: str, settings: SmoothSettings, access: Access) -> Document:
    """Return the document that a source is whose bytes have been read already; see `open_input`."""
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    if kind_of(data, name) == "volume":
        from beltrami_cli.samples.vertices.level_set import LevelSetDocument

        return LevelSetDocument(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    refuse_options_of_level_sets(settings, name)
    return document_of(data, source, access)


def refuse_options_of_level_sets(settings: SmoothSettings, name: str) -> None:
    """Raise UsageError if there are any, for a file that is no level set."""
    if settings.level_set.given:
        raise UsageError(f"{', '.join(settings.level_set.given)}: for level sets, and {name} is none")


def coloured_vertices(document: Document) -> NDArray[np.bool_]:
    """Return which vertices of a document have a place and a colour of their own, shape (V,)."""
    import numpy as np

    from beltrami_cli.samples.vertices.level_set import LevelSetDocument

    painted = document.painted()
    valid = np.asarray(np.isfinite(painted.positions).all(axis=1))
    if isinstance(document, LevelSetDocument):  # whose vertices without colours are in no triangle
        found = np.zeros(len(valid), bool)
        found[painted.faces] = True
        valid &= found
    return valid


def open_pixels(
    picture: Picture, settings: SmoothSettings, access: Access
) -> tuple[ImageColours, NDArray[np.bool_]]:
    """Return the colours of a picture, and where it has no hole, shape (H, W)."""
    # Holes are where the mask says so, values are not finite, or nothing is seen. Further channels than colours take
    # part only where the settings name them.
    from beltrami_cli.samples.images.colours import ImageColours
    from beltrami_cli.samples.images.surface import read_surface

    if settings.channels is None:
        names = ("red", "green", "blue") if len(picture.colour) == 3 else ("grey",)
        settings = dataclasses.replace(settings, channels=names)
    colours = ImageColours(picture, settings)
    surface = read_surface(picture, settings.image, access)
    return colours, surface.valid & colours.usable() & colours.visible()
