"""What a kernel on samples of a kind needs to be found, named and drawn."""
