"""A file for each command, named after it; `registry` lists them."""
