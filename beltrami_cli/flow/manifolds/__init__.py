"""Image manifolds on meshes and on canvases, their geometry, and the parts that parameters are tried on."""
