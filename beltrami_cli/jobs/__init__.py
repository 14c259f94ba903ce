"""One file or folder for each thing that can be done with files; errors are raised, and nothing is printed."""
