"""Open the file that a job reads, as a document."""

from __future__ import annotations

from dataclasses import replace

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import given_parameters
from beltrami_cli.formats import registry
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access, read_source
from beltrami_cli.layers.settings import SmoothSettings


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as a document; errors if it is unsupported, or no level set."""
    document = open_any(source, settings, access)
    require_level_set(settings, document)
    return document


def require_level_set(settings: SmoothSettings, *documents: Document) -> None:
    """Raise UsageError if options of level sets are given, and none of the documents is one."""
    wrong = [each.flag for each in given_parameters(settings.level_set)]
    if wrong and all(document.kind != "volume" for document in documents):
        raise UsageError(f"{', '.join(wrong)} need a level set, and {documents[0].name} is not one")


def open_any(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a file as `open_input`, and allow options of level sets for any file."""
    data, access = read_source(source, access), replace(access, channels=settings.channels or ())
    name, folder = registry.name_and_folder(source)
    line = registry.recognised(data, name)
    if line is not None and line.kind == "volume":
        from beltrami_cli.layers.level_set_document import read_level_set

        return read_level_set(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    return registry.open_as(line, data, name, folder, access)
