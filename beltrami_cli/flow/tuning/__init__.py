"""Parameters that are chosen from the data."""
