"""What each job is told."""
