"""The noise of colours: its size and its structure.

`reading.estimate_noise` makes a noise model (`model`) of a surface in these steps:

1. `neighbourhoods` cuts the colours into squares of a grid (`grid_squares`, `jpeg_traces`) or clusters of vertices
   (`clusters`): `ThreeChannels`, in units of `components`. They have statistics for each scale (`cells`).
2. `features` describes each neighbourhood, and the most even cells of all of them (`even_cells`).
3. Two networks read the noise from these features (`network`, `candidates`) and from what pilots remove (`size`). A
   pilot is a quick estimate of the clean colours.
4. Covariances (`channel_noise`) and the dependence on level and place (`structure`, `structure_search`) are measured
   on the residual of a pilot that removes this noise (`residual`).

`stabiliser` makes noise the same at all levels, and `drawing` draws it.
"""
