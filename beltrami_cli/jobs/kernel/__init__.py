"""One kernel, to look at."""
