"""PLY: documents that keep their bytes, and writers for conversion."""

from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.ply.writer import write_ply, write_textured_ply

__all__ = ["PlyDocument", "write_ply", "write_textured_ply"]
