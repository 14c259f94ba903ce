"""Opening the input of a job: a model, an image, or a level set, which is triangulated first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.registry import document_of, kind_of

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings import SmoothSettings


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as the document that it is.

    Raises InputError if it cannot be read, or is of none of the formats, and UsageError if there are settings of
    level sets, and it is none.
    """
    return document_from(read_source(source, access), source, settings, access)


def document_from(data: bytes, source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a source whose bytes have been read already; see `open_input`."""
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    kind = kind_of(data, name)
    if kind == "volume":
        from beltrami_cli.samples.voxels import LevelSetDocument

        return LevelSetDocument(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    if settings.level_set.given:
        raise UsageError(f"{', '.join(settings.level_set.given)}: for level sets, and {name} is none")
    if kind == "image":
        from beltrami_cli.formats.image.document import ImageDocument

        return ImageDocument(data, name, folder, access)
    return document_of(data, source, access)
