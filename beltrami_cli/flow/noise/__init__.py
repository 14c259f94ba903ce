"""The noise of colours: its size and its structure.

- `reading` estimates a noise model (`model`), from the noise of groups of channels (`channel_noise`).
- Colours are cut into squares of a grid or clusters of vertices (`neighbourhoods`, `grid_squares`, `clusters`).
- Two networks read the noise (`network`, `size`) from features of these (`features`, `jpeg_traces`).
- Covariances, and the dependence on level and place (`structure`), are measured on the residual of a quick estimate of
  the clean colours, the pilot (`residual`).
- `stabiliser` makes noise the same at all levels, and `drawing` draws it.
"""
