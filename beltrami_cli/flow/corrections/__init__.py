"""Corrections of what the mean of a kernel gets wrong.

- `outliers` are filled before anything else. They are found by `comparison` with the samples around, as small `clumps`
  whose places are random (`spread`).
- `coarse_levels` remove noise that neighbours share, after its `dark_outliers` are filled.
- `clipping` restores colours whose noise was clipped (by `normal_tables`), and `mean_light` the mean radiance.
- `jpeg_image` decodes JPEG again, by the noise before compression (`jpeg_noise`).
"""
