"""What is coloured in a file, and what smoothing would do with it."""
