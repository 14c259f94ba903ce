"""File formats: a file is opened as a document that keeps its bytes, and only its colours are patched."""
