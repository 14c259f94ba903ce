"""Which formats are read only, and how they are told apart."""

from __future__ import annotations

import re
from typing import Literal

from beltrami_cli.formats.foreign.off import HEADER
from beltrami_cli.formats.foreign.stl import is_binary_stl

Kind = Literal["off", "stl", "3mf", "dae", "zae", "3dxml", "xaml"]

_XML: dict[str, Kind] = {".dae": "dae", ".xaml": "xaml"}
_STARTS_XML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<|\xff\xfe<|\xfe\xff\0<")  # UTF-8 or UTF-16
_ARCHIVES: dict[str, Kind] = {".3mf": "3mf", ".zae": "zae", ".3dxml": "3dxml"}


def kind_of(data: bytes, name: str) -> Kind | None:
    """Tell the format of a file by its content, and by its name where many formats have such content; None: another.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name.
    """
    suffix = "." + name.lower().rpartition(".")[2]
    if data[:2] == b"PK":
        return _ARCHIVES.get(suffix)
    if HEADER.match(data):
        return "off"
    if suffix == ".stl" and (data[:5].lower() == b"solid" or is_binary_stl(data)):
        return "stl"
    return _XML.get(suffix) if _STARTS_XML.match(data) else None
