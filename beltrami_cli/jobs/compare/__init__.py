"""Two files held against each other."""
