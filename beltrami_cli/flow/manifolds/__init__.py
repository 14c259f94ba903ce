"""Image manifolds: what smoothing needs of a surface, and both kinds of surfaces.

`grid_*`, `canvas` and `seams` are about the canvases of textures and images, `mesh_*` about triangulated surfaces.
"""
