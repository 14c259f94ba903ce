"""Writing the files of a run: all or none."""
