"""Opening the input of a job: a model as it is, or a level set, which is triangulated first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.registry import document_of, kind_of

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings.smooth import SmoothSettings


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input, as the document that it is.

    Parameters
    ----------
    source : str
        Path, or "-" for standard input.
    settings : SmoothSettings
        Which surface in a volume is meant, where its colours are, and how many threads there are.
    access : Access
        What may be read.

    Returns
    -------
    Document

    Raises
    ------
    InputError
        If the file cannot be read, or is of none of the formats.
    UsageError
        If settings of level sets are given, and it is none.
    """
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
