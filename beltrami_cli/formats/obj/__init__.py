"""OBJ: documents that keep their bytes, and writers for conversion."""

from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.obj.writer import write_obj, write_textured_obj

__all__ = ["ObjDocument", "write_obj", "write_textured_obj"]
