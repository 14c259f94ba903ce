"""USD: documents that keep their layers, and writers for conversion."""
