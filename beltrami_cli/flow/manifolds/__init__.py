"""Image manifolds on meshes and canvases, their geometry, and the samples on which parameters are tried."""
