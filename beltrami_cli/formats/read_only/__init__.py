"""Mesh formats that are read only: their coloured parts are written as PLY, OBJ or glTF."""
