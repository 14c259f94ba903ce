"""Files that a model names: which are read, and how those of an output are called."""
