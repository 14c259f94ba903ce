"""One file a job: read, sample, iterate, write."""
