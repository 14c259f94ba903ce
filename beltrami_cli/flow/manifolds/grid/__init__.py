"""The manifolds of textures and images: `manifold` on the `geometry` of an atlas, whose stacks are planes of a canvas.

`canvas` puts colours on the canvas and takes them off, `seams` ends it where colours jump, and `margins` are the cells
that smoothing reads beyond a chart. `kernel` and `gaussian` average cells, near cuts by `connected_means`.
"""
