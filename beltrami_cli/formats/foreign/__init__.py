"""Formats that are read only: what is coloured in them is written as PLY, OBJ or glTF."""

from beltrami_cli.formats.foreign.document import ForeignDocument
from beltrami_cli.formats.foreign.recognition import kind_of

__all__ = ["ForeignDocument", "kind_of"]
