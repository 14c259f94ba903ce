"""Whether the work on images fits into memory, told before any of them is decoded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.measuring import measure_image

if TYPE_CHECKING:
    from collections.abc import Iterable

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.mesh.textured import Slot
    from beltrami_cli.pipeline.settings.smooth import TextureSettings

_FLOATS = 2 * 4  # the old and the new colours of one image at a time, in single precision


def require_room(images: Iterable[tuple[str, bytes]], access: Access) -> None:
    """Refuse images that cannot fit into memory when they are decoded and smoothed.

    Parameters
    ----------
    images : iterable of (str, bytes)
        Names and contents of the files that are decoded together.
    access : Access
        How much memory there is.

    Raises
    ------
    InputError
        If the least that is certainly needed is more: all images as stored, and one of them twice as floats.
    """
    if access.memory is None:
        return
    decoded, working = 0, 0
    for name, data in images:
        size = measure_image(data)
        if size is None:
            continue  # whoever decodes it tells what is wrong
        decoded += size.decoded
        working = max(working, size.samples * _FLOATS)
        if decoded + working > access.memory:
            cause = (
                f"its {size.width} x {size.height} pixels of {size.channels} channels do not fit into memory"
            )
            raise InputError(name, cause, "scale it down, or raise --max-memory")


def require_room_for_textures(
    document: Document, slots: Iterable[Slot], wanted: TextureSettings, access: Access
) -> None:
    """Do so for the chosen textures of a document, one slot at a time.

    Raises
    ------
    InputError
        As `require_room` and `Document.textured`.
    """
    for slot in slots:
        from beltrami_cli.pipeline.textures.prepare import choose_textures

        chosen = choose_textures(document.textured(slot), wanted)
        require_room(((texture.name, texture.data) for texture in chosen.textures), access)
