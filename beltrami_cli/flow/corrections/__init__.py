"""Corrections of what the mean of a kernel gets wrong.

- `outliers` are filled before anything else: by `comparison` with the samples around, as small `clumps`, by their
  `spread`. `dark_outliers` of shared noise are filled before `coarse_levels` remove it.
- `clipping` restores colours whose noise was clipped (by `normal_tables`), and `mean_light` the mean radiance.
- `jpeg_image` decodes JPEG again, by the noise before compression (`jpeg_noise`).
"""
