"""Documents that keep their bytes: open, list the coloured parts, patch the colours, and nothing else."""
