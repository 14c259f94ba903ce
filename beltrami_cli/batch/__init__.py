"""Many files, one after another or side by side."""
