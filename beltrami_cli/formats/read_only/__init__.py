"""Mesh formats that are only read: their coloured parts are written as PLY, OBJ or glTF.

`off`, `stl`, `threemf` and `collada` read `ColouredPolygons`, of which `document` makes vertex colours; `xml` is shared
by the last two.
"""
