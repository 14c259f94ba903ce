"""Opening the input of a job: a model as it is, or a level set, which is triangulated first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.source import read_source, recognise
from beltrami_cli.pipeline.level_set_settings import DEFAULT_LEVEL_SET, LevelSetSettings

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document


def open_input(
    source: str,
    access: Access = EVERYTHING_INSIDE,
    level_set: LevelSetSettings = DEFAULT_LEVEL_SET,
    threads: int = 1,
) -> Document:
    """Read a file, or standard input, as the document that it is.

    Parameters
    ----------
    source : str
        Path, or "-" for standard input.
    access : Access
        What may be read.
    level_set : LevelSetSettings
        The surface in a volume, and its colours.
    threads : int
        To triangulate with.

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
    from beltrami_cli.formats.volume import is_volume

    data = read_source(source, access)
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    if is_volume(data, name):
        from beltrami_cli.pipeline.level_set import LevelSetDocument

        return LevelSetDocument(data, name, folder, level_set, access, threads)
    if level_set.given:
        raise UsageError(f"{', '.join(level_set.given)}: for level sets only, and {name} is none")
    return recognise(data, name, folder, access)
