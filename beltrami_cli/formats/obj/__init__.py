"""OBJ: documents that keep their bytes, and writers for conversion."""
