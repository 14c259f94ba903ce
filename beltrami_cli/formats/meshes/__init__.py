"""Meshes between formats.

Readers of textured formats fill a `scene`; `scene_surface` makes the surface of one slot of it, to be smoothed, and
`scene_mesh` a mesh with all materials, to be converted. `coloured_polygons` become vertex colours, where colours are
of faces or corners. `writing` is what the writers of all formats share.
"""
