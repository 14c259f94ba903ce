"""What is in a file, which of it is worked on, and what belongs beside it."""
