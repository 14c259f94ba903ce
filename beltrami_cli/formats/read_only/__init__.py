"""Mesh formats that are read only: what is coloured in them is written as PLY, OBJ or glTF."""

from beltrami_cli.formats.read_only.document import ReadOnlyDocument, kind_of

__all__ = ["ReadOnlyDocument", "kind_of"]
