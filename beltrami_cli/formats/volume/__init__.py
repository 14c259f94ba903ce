"""Level sets sampled on a grid, and colours for them, in NumPy archives and NRRD files."""
