"""Documents that keep their bytes: open, list what is coloured, patch the colours, and nothing else."""
