"""Comparison of two files.

- `files` compares files, `documents` compares opened ones: `selection` chooses the parts, if it is the `same_model`.
- `vertex_parts` and `pixel_parts` match the samples of both, and `measured` takes their differences.
- `figures` makes figures of these, with the formulas of `similarity`; `limits` holds figures to limits, `maps` draw.
"""
