"""Colours of vertices and points: from documents and arrays to the flow and back."""
