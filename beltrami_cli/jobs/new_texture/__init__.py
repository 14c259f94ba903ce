"""New textures of meshes: `from_vertices` and `from_textures` make the mesh and its `texture`."""
