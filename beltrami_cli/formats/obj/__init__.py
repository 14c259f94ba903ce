"""Wavefront OBJ.

`statements` finds the tokens of a file by lines. `vertices` reads positions, colours and polygons from them, with the
colours of `polypaint`, and `scene` texture coordinates, normals and groups; `materials` are in libraries. `renaming`
names the sidecar files of an output, and the references to them. `writer` is for conversions.
"""
