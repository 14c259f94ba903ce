"""Mesh formats that are read only: what is coloured in them is written as PLY, OBJ or glTF."""
