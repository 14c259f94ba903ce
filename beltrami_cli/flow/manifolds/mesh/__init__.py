"""The manifolds of meshes and point clouds: `manifold` on the `geometry` of triangles; stacks have a row per sample.

`fingerprints` make random choices independent of the order of samples, `kernel_work` bounds kernels around hubs, and
`regions` are the samples over which sums and means are taken.
"""
