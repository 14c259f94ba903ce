"""The method: estimate the noise, choose parameters, smooth.

1. `estimation` estimates the noise (`noise/`), and stabilises its variance. `decoding` does so for textures and images,
   and may decode JPEG again.
2. `plan` chooses `parameters` (`choice/`), after it has removed the noise that neighbours share (`corrections/`).
3. `beltrami_flow` iterates the kernel on a manifold (`manifolds/`). `patches` adds an estimate by similar patches,
   whose channels `mixing` decorrelates, and `blending` weighs both results.

The steps share:

- `given_noise`, `noise_amount`: noise that the user gives, and how much noise counts.
- `chunks`, `cuts`: parts of a surface that are processed one after another, and how it is cut into them.
- `vertex_graph`, `mesh_gaussian`: clusters of vertices, and means over their neighbours.
"""
