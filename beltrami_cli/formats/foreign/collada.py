"""COLLADA files with vertex colours, read by pycollada in a process that can be ended."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.parsers import expat

from beltrami_cli.errors import InputError
from beltrami_cli.formats.foreign.archive import Archive
from beltrami_cli.formats.foreign.asking import ask_worker

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.foreign.painting import PaintedPolygons


def read_dae(data: bytes, name: str, access: Access) -> PaintedPolygons:
    """Read a COLLADA file, or the first one in an archive (.zae).

    Raises
    ------
    InputError
        If it is damaged, has a document type, or takes too long or too much memory; or pycollada is missing.
    """
    if data[:2] == b"PK":
        archive = Archive(data, name, access)
        member = next((each for each in archive.members if each.lower().endswith(".dae")), None)
        if member is None:
            raise InputError(name, "the archive has no .dae file in it")
        data = archive.read(member)
    _check(data, name)
    return ask_worker("dae", data, name, access)


def _check(data: bytes, name: str) -> None:
    """Refuse what is not XML to its end, which pycollada would read as far as it goes, and what may grow in it."""
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError) as error:
        raise InputError(name, f"it is damaged ({error})", "export it again") from error


def _refuse(*_: object) -> None:
    raise ValueError("a document type, which could make it grow without bounds, is not allowed")
