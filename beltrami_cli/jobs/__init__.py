"""What a command does with its files; it raises what went wrong, and prints nothing."""
