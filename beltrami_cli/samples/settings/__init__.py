"""The parameters of a smoothing job, with their defaults; light enough for the command line to import."""
