"""Image manifolds: surfaces with colours, on which distances are measured and colours are averaged.

Everything outside of this package that smooths works with any `Manifold`. There are two kinds, in a folder each:
`mesh.manifold` for triangulated surfaces and point clouds, `grid.manifold` for the canvases of textures and images.
Both folders have these files: `geometry`, similar `patches`, coarse `levels`, `trial` with the parts on which
parameters are tried, `perturbations` for estimated errors, and `surroundings`, among which outliers are found.

What both kinds share:

- `manifold`, `geometry`, `domain`: the interfaces of a manifold, of its samples, and of sums and means over them.
- `iteration`, `metric_channels`, `guides`, `moving_positions`, `beta`: one iteration, and what its metric consists of.
- `kernel_work`, `search_range`: the workload of kernels, and the parameters that are tried.
- `stabilised_colours`, `new_colours`: the colours of a manifold, and the colours that are written back.
- `blocks`: passes over stacks, several blocks at a time.
"""
