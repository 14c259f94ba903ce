"""PLY, text or binary.

`header` says which elements there are, and `tables` finds their rows. `colours`, `polygons` and `texturing` know which
properties are colours, faces, grids and texture coordinates. `writer` is for conversions.
"""
